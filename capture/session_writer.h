// Writes one session folder while it is captured: the journal's first line and the manifest, frames
// and journal as they come, manifest again at the end.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "capture/bounded_queue.h"
#include "capture/captured_frame.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// Calls come from the session thread; frames and journal lines are written by a thread of its own.
// Frames never wait in vain: the queue has room for every slot of the plan, and what was taken is
// written even when the capture is aborted. Each frame file is whole or absent, and replaces none.
// While one exists, the journal is locked (flock): is_under_way() in capture/stored_take.h sees it.
class SessionWriter {
 public:
  // Makes a new folder in `directory`, never an existing one: with a name that is taken, "-2",
  // "-3" ... is appended. `plan` is plan_manifest()'s; the auxiliary files that it names are copied
  // from beside `calibration_file`. `first_line` opens the journal before the folder has a
  // manifest: a session says how it was begun, whenever its process dies.
  // Errors: kUnwritable, kNotFound; then the folder is removed again.
  static estimation::Result<std::unique_ptr<SessionWriter>> create(
      const std::filesystem::path& directory, estimation::Manifest plan,
      const std::filesystem::path& calibration_file, const std::string& first_line);
  // Goes on with a session that is there: `plan` has a record for every slot, `is_stored` says
  // which of them are on the disk already, with all that their records shall say, and
  // `journal_byte_count` how long the journal was when that was found out. The journal goes on
  // where it ended; nothing else is touched before the first write(). Errors: kUnwritable, also
  // where another process has the session open, or had since.
  static estimation::Result<std::unique_ptr<SessionWriter>> go_on(
      const std::filesystem::path& folder, estimation::Manifest plan, std::vector<bool> is_stored,
      std::uintmax_t journal_byte_count);
  ~SessionWriter();
  SessionWriter(const SessionWriter&) = delete;
  SessionWriter& operator=(const SessionWriter&) = delete;

  const std::filesystem::path& folder() const { return folder_; }
  // The plan with the session's own id and file names; before the first write().
  const estimation::Manifest& manifest() const { return manifest_; }

  void write(const CapturedFrame& frame);
  // The slot's frame does not show its pattern: its file becomes "*.wrong_picture", which no reader
  // of sessions looks at, and the slot is open again.
  void set_aside(SlotId slot);
  void journal(std::string json_line);
  // The first thing that could not be written; thread-safe.
  std::optional<estimation::InputError> fault() const;

  // Waits for all that was handed over, sees that it is still there, then rewrites the manifest
  // with the frames that are on disk. Once. Errors: fault()'s, or the manifest's own; a session
  // that could not be stored is `failed` as far as that can be written.
  estimation::Result<void> finish(estimation::SessionState state,
                                  std::optional<estimation::SessionFailure> failure);

 private:
  // An open file, or none.
  class Descriptor {
   public:
    explicit Descriptor(int number = -1) : number_(number) {}
    Descriptor(Descriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
    Descriptor& operator=(Descriptor&&) = delete;
    ~Descriptor() { close(); }
    bool is_open() const { return number_ >= 0; }
    int number() const { return number_; }
    void close();

   private:
    int number_;
  };
  struct Files {
    Descriptor journal;
    Descriptor reserve;  // without a name: room for the last manifest, even on a full disk
  };
  using Job = std::variant<CapturedFrame, SlotId, std::string>;

  SessionWriter(std::filesystem::path folder, estimation::Manifest plan,
                std::vector<bool> is_stored, Files files);
  void run();
  void store(const CapturedFrame& frame);
  void store(const std::string& line);
  void store(SlotId wrong);
  struct StoredFile {
    std::string sha256;
    std::size_t byte_count = 0;
  };
  estimation::Result<StoredFile> store_pixels(const CapturedFrame& frame, const std::string& file);
  std::size_t slot_index(SlotId slot) const;
  void check_still_there();
  void set_fault(estimation::InputError error);

  const std::filesystem::path folder_;
  estimation::Manifest manifest_;  // frames: one record a slot; the write thread fills them in
  std::vector<bool> is_stored_;    // [slot]; the write thread's until it has ended
  Files files_;                    // the write thread's until it has ended
  mutable std::mutex mutex_;
  std::optional<estimation::InputError> fault_;  // guarded by mutex_
  BoundedQueue<Job> queue_;
  std::jthread thread_;
};

}  // namespace capture
