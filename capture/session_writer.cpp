#include "capture/session_writer.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <limits>
#include <system_error>
#include <tuple>
#include <utility>

#include "capture/session_plan.h"
#include "capture/stored_take.h"
#include "estimation/session/frame_io.h"
#include "nlohmann/json.hpp"

namespace capture {
namespace {

using estimation::InputError;
using estimation::InputFault;
using estimation::Manifest;
using estimation::Result;
using estimation::SessionState;
namespace fs = std::filesystem;

// Journal lines come six to a frame; so many may wait beside the frames before push() blocks.
constexpr std::size_t kJournalRoom = 4096;

tl::unexpected<InputError> unwritable(const fs::path& path, const std::string& cause) {
  return tl::unexpected(InputError{InputFault::kUnwritable, path.string(), "",
                                   cause + "; make room or choose another folder"});
}

// A file without a name that takes up as much room as the manifest of a whole session will; -1
// where the file system knows no such file.
int reserve_room(const fs::path& folder, const Manifest& plan) {
  Manifest whole = plan;
  for (estimation::FrameRecord& frame : whole.frames) {
    frame.frame_id = std::numeric_limits<std::uint64_t>::max();
    frame.camera_timestamp_ns = frame.edge_timestamp_ns = std::numeric_limits<std::int64_t>::min();
    frame.sha256 = std::string(64, 'f');
  }
  constexpr std::size_t kFailureBytes = 64 << 10;  // and each slot may be named there once more
  const std::size_t byte_count = estimation::format_manifest(whole).size() + kFailureBytes;
  const int file = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  // A disk without that much room: the first frame will say so.
  if (file >= 0) std::ignore = ::posix_fallocate(file, 0, static_cast<off_t>(byte_count));
  return file;
}

bool write_all(int file, const std::string& text) {
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t count = ::write(file, text.data() + done, text.size() - done);
    if (count < 0 && errno != EINTR) return false;
    if (count > 0) done += static_cast<std::size_t>(count);
  }
  return true;
}

// A folder that did not exist before: making it is what claims the name.
Result<fs::path> make_folder(const fs::path& directory, const std::string& name) {
  constexpr int kNameLimit = 1000;
  for (int number = 1; number <= kNameLimit; ++number) {
    const fs::path folder = directory / (number == 1 ? name : name + "-" + std::to_string(number));
    std::error_code error;
    if (fs::create_directory(folder, error)) return folder;
    if (error) return unwritable(folder, "the session folder cannot be made: " + error.message());
  }
  return unwritable(directory / name, "every name for the session is taken");
}

// They come along, and the manifest names the copies.
Result<void> copy_auxiliary_files(const fs::path& folder, const fs::path& calibration_file,
                                  Manifest& manifest) {
  for (std::string* file : auxiliary_files(manifest.calibration)) {
    const fs::path source = calibration_file.parent_path() / *file;
    const fs::path name = fs::path("calibration") / source.filename();
    std::error_code error;
    fs::create_directories(folder / "calibration", error);
    const fs::path temporary = folder / (name.string() + ".tmp");
    if (!error) fs::copy_file(source, temporary, error);
    // Whole under its name or not there, as every file of a session.
    if (!error)
      if (auto placed = estimation::put_in_place(temporary, folder / name); !placed) return placed;
    if (error)
      return tl::unexpected(InputError{InputFault::kNotFound, source.string(), "",
                                       "a file of the calibration cannot be copied (" +
                                           error.message() + "); " + calibration_file.string() +
                                           " names it"});
    *file = name.string();
  }
  return {};
}

}  // namespace

Result<std::unique_ptr<SessionWriter>> SessionWriter::create(const fs::path& directory,
                                                             Manifest plan,
                                                             const fs::path& calibration_file,
                                                             const std::string& first_line) {
  const auto folder = make_folder(directory, plan.id);
  if (!folder) return tl::unexpected(folder.error());
  plan.id = folder->filename().string();
  const auto begin = [&]() -> Result<Files> {
    std::error_code error;
    if (!fs::create_directory(*folder / "frames", error))
      return unwritable(*folder / "frames", "the folder cannot be made: " + error.message());
    // The manifest makes the folder a session: by then the journal says how the take was begun.
    const fs::path path = *folder / "journal.jsonl";
    Descriptor journal(
        ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0666));
    if (!journal.is_open()) return unwritable(path, std::strerror(errno));
    // A file system without locks: then an interrupted take is not told from one under way.
    std::ignore = ::flock(journal.number(), LOCK_EX | LOCK_NB);
    if (!write_all(journal.number(), first_line + "\n") || ::fdatasync(journal.number()) != 0)
      return unwritable(path, std::strerror(errno));
    if (const auto copied = copy_auxiliary_files(*folder, calibration_file, plan); !copied)
      return tl::unexpected(copied.error());
    Manifest empty = plan;
    empty.frames.clear();
    if (const auto written = store_manifest(*folder, empty); !written)
      return tl::unexpected(written.error());
    return Files{std::move(journal), Descriptor(reserve_room(*folder, plan))};
  };
  auto files = begin();
  if (!files) {
    std::error_code ignored;  // the first error is the one to tell
    fs::remove_all(*folder, ignored);
    return tl::unexpected(files.error());
  }
  std::vector<bool> is_stored(plan.frames.size(), false);
  return std::unique_ptr<SessionWriter>(
      new SessionWriter(*folder, std::move(plan), std::move(is_stored), std::move(*files)));
}

Result<std::unique_ptr<SessionWriter>> SessionWriter::go_on(const fs::path& folder, Manifest plan,
                                                            std::vector<bool> is_stored,
                                                            std::uintmax_t journal_byte_count) {
  const fs::path path = folder / "journal.jsonl";
  Descriptor journal(::open(path.c_str(), O_RDWR | O_APPEND | O_CLOEXEC));
  if (!journal.is_open()) return unwritable(path, std::strerror(errno));
  if (::flock(journal.number(), LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
    return tl::unexpected(InputError{InputFault::kUnwritable, folder.string(), "",
                                     "another ssrig is capturing into it; let that one end"});
  const off_t end = ::lseek(journal.number(), 0, SEEK_END);
  if (end < 0 || static_cast<std::uintmax_t>(end) != journal_byte_count)
    return tl::unexpected(InputError{InputFault::kUnwritable, folder.string(), "",
                                     "another ssrig has gone on with it meanwhile; see what it "
                                     "lacks with ssrig verify, and start again"});
  // A power cut may have left half a line; what follows starts on its own.
  char last = '\n';
  if (end > 0) std::ignore = ::pread(journal.number(), &last, 1, end - 1);
  if (last != '\n' && !write_all(journal.number(), "\n"))
    return unwritable(path, std::strerror(errno));
  Files files{std::move(journal), Descriptor(reserve_room(folder, plan))};
  return std::unique_ptr<SessionWriter>(
      new SessionWriter(folder, std::move(plan), std::move(is_stored), std::move(files)));
}

SessionWriter::SessionWriter(fs::path folder, Manifest plan, std::vector<bool> is_stored,
                             Files files)
    : folder_(std::move(folder)),
      manifest_(std::move(plan)),
      is_stored_(std::move(is_stored)),
      files_(std::move(files)),
      queue_(manifest_.frames.size() + kJournalRoom),
      thread_([this] { run(); }) {}

void SessionWriter::Descriptor::close() {
  if (is_open()) ::close(std::exchange(number_, -1));
}

SessionWriter::~SessionWriter() { queue_.close(); }

void SessionWriter::write(const CapturedFrame& frame) { queue_.push(frame); }
void SessionWriter::set_aside(SlotId slot) { queue_.push(slot); }
void SessionWriter::journal(std::string json_line) { queue_.push(std::move(json_line)); }

std::optional<InputError> SessionWriter::fault() const {
  const std::lock_guard lock(mutex_);
  return fault_;
}

void SessionWriter::set_fault(InputError error) {
  const std::lock_guard lock(mutex_);
  if (!fault_) fault_ = std::move(error);
}

void SessionWriter::run() {
  while (auto job = queue_.pop()) std::visit([this](const auto& item) { store(item); }, *job);
}

std::size_t SessionWriter::slot_index(SlotId slot) const {
  const std::size_t bracket_count = manifest_.frames.size() / manifest_.patterns.size();
  return static_cast<std::size_t>(slot.pattern) * bracket_count +
         static_cast<std::size_t>(slot.bracket);
}

void SessionWriter::store(const CapturedFrame& frame) {
  const std::size_t index = slot_index(frame.slot);
  estimation::FrameRecord& record = manifest_.frames[index];
  const auto stored = store_pixels(frame, record.file);
  if (!stored) return set_fault(stored.error());
  const auto in_ns = [](auto time) {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(time.time_since_epoch()).count();
  };
  record.frame_id = frame.evidence.block_id;
  record.camera_timestamp_ns = in_ns(frame.evidence.camera_timestamp);
  record.edge_timestamp_ns = in_ns(frame.evidence.edge);
  record.sha256 = stored->sha256;
  is_stored_[index] = true;
  store(nlohmann::json{{"event", "frame stored"},
                       {"pattern", frame.slot.pattern},
                       {"bracket", frame.slot.bracket},
                       {"exposure_us", record.exposure_us},
                       {"file", record.file},
                       {"byte_count", stored->byte_count},
                       {"frame_id", *record.frame_id},
                       {"camera_timestamp_ns", *record.camera_timestamp_ns},
                       {"edge_timestamp_ns", *record.edge_timestamp_ns},
                       {"sha256", *record.sha256}}
            .dump());
}

void SessionWriter::store(SlotId wrong) {
  const std::size_t index = slot_index(wrong);
  const estimation::FrameRecord& record = manifest_.frames[index];
  if (!is_stored_[index]) return;  // it could not be written: fault() says so
  const auto aside = capture::set_aside(folder_ / record.file, ".wrong_picture");
  if (!aside) return set_fault(aside.error());
  is_stored_[index] = false;
  store(nlohmann::json{{"event", "frame set aside"},
                       {"pattern", wrong.pattern},
                       {"bracket", wrong.bracket},
                       {"file", record.file},
                       {"aside", aside->lexically_relative(folder_).string()}}
            .dump());
}

Result<SessionWriter::StoredFile> SessionWriter::store_pixels(const CapturedFrame& frame,
                                                              const std::string& file) {
  const FrameSamples samples(*frame.frame);
  std::error_code unknown;
  // set_aside() has been through here: whatever else has the slot's name was not stored by us.
  if (fs::exists(fs::symlink_status(folder_ / file, unknown)))
    return unwritable(folder_ / file, "is there already, and nothing captured is overwritten");
  const auto tiff =
      estimation::encode_frame_tiff(samples.view(), manifest_.camera.pixel_format.bit_depth);
  if (!tiff) return tl::unexpected(tiff.error());
  if (const auto written = estimation::write_file_atomically(folder_ / file, *tiff); !written)
    return tl::unexpected(written.error());
  return StoredFile{estimation::sha256_hex(*tiff), tiff->size()};
}

void SessionWriter::store(const std::string& line) {
  if (!files_.journal.is_open()) return;
  const int journal = files_.journal.number();
  // At once, line by line: after a crash of the program the journal is whole.
  const off_t line_start = ::lseek(journal, 0, SEEK_END);
  if (write_all(journal, line + "\n")) return;
  set_fault(unwritable(folder_ / "journal.jsonl", std::strerror(errno)).value());
  std::ignore = ::ftruncate(journal, line_start);  // it ends with a whole line
  files_.journal.close();
}

// Somebody may have cleared away meanwhile what we have written.
void SessionWriter::check_still_there() {
  for (std::size_t i = 0; i < manifest_.frames.size(); ++i) {
    const fs::path path = folder_ / manifest_.frames[i].file;
    std::error_code unknown;
    if (!is_stored_[i] || fs::is_regular_file(path, unknown)) continue;
    is_stored_[i] = false;
    set_fault({InputFault::kUnwritable, path.string(), "",
               "was stored, and another program has removed it since; see which, and take what is "
               "missing with ssrig capture --resume"});
  }
}

Result<void> SessionWriter::finish(SessionState state,
                                   std::optional<estimation::SessionFailure> failure) {
  queue_.close();
  thread_.join();
  files_.reserve.close();
  if (files_.journal.is_open() && ::fsync(files_.journal.number()) != 0)
    set_fault(unwritable(folder_ / "journal.jsonl", std::strerror(errno)).value());
  check_still_there();
  const auto unstored = fault();
  manifest_.state = unstored && state == SessionState::kComplete ? SessionState::kFailed : state;
  manifest_.failure = std::move(failure);
  if (unstored && !manifest_.failure)
    manifest_.failure = estimation::SessionFailure{"storage", {}, unstored->text()};
  Manifest written = manifest_;
  written.frames.clear();
  for (std::size_t i = 0; i < manifest_.frames.size(); ++i)
    if (is_stored_[i]) written.frames.push_back(manifest_.frames[i]);
  const auto result = store_manifest(folder_, written);
  if (unstored) return tl::unexpected(*unstored);
  return result;
}

}  // namespace capture
