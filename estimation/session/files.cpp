#include "estimation/session/files.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;

// An open file; closes when it goes out of scope.
class Descriptor {
 public:
  explicit Descriptor(int number) : number_(number) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (number_ >= 0) ::close(number_);
  }
  bool is_open() const { return number_ >= 0; }
  int number() const { return number_; }
  // Some file systems report a full disk only here.
  bool close() { return ::close(std::exchange(number_, -1)) == 0; }

 private:
  int number_;
};

InputError read_error(const fs::path& path, int error_number) {
  const bool is_absent = error_number == ENOENT || error_number == ENOTDIR;
  return {is_absent ? InputFault::kNotFound : InputFault::kUnreadable, path.string(), "",
          explain_errno(error_number)};
}

InputError write_error(const fs::path& path, int error_number) {
  return {InputFault::kUnwritable, path.string(), "", explain_errno(error_number)};
}

// Returns 0 or the errno.
int write_all(int descriptor, const std::vector<std::byte>& bytes) {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t count = ::write(descriptor, bytes.data() + done, bytes.size() - done);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return errno;
    done += static_cast<std::size_t>(count);
  }
  return 0;
}

// Returns 0 or the errno. O_NOFOLLOW: a link planted under the temporary name is not written
// through.
int write_and_sync(const fs::path& path, const std::vector<std::byte>& bytes) {
  Descriptor file(
      ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0666));
  if (!file.is_open()) return errno;
  if (const int error_number = write_all(file.number(), bytes); error_number != 0) {
    return error_number;
  }
  if (::fdatasync(file.number()) != 0) return errno;
  return file.close() ? 0 : errno;
}

// Makes a rename durable. Returns 0 or the errno.
int sync_folder(const fs::path& folder) {
  const Descriptor descriptor(
      ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!descriptor.is_open()) return errno;
  // EINVAL: a file system without this notion (some network mounts); nothing more can be done.
  return ::fsync(descriptor.number()) == 0 || errno == EINVAL ? 0 : errno;
}

bool is_inside(const fs::path& folder, const fs::path& path) {
  const auto [folder_end, path_rest] =
      std::mismatch(folder.begin(), folder.end(), path.begin(), path.end());
  return folder_end == folder.end();
}

}  // namespace

std::string objection_to_name(const std::string& name) {
  if (name.empty()) return "it is empty";
  if (name.find('\0') != std::string::npos) return "it holds a zero byte";
  const fs::path path(name);
  if (path.is_absolute()) return "it is absolute";
  for (const fs::path& part : path) {
    if (part == "..") return "it holds \"..\"";
  }
  return {};
}

std::string explain_errno(int error_number) {
  std::string cause = std::generic_category().message(error_number);
  switch (error_number) {
    case ENOSPC:
    case EDQUOT:
      return cause + ": free space on this disk or choose a folder on another";
    case EMFILE:
    case ENFILE:
      return cause + ": raise the limit (ulimit -n) or close other programs";
    case EIO:
      return cause + ": the disk fails; see dmesg and choose a folder on another";
    case EFBIG:
      return cause + ": the file system or a limit (ulimit -f) refuses files of this size";
    case EACCES:
    case EPERM:
      return cause + ": give this user the permission or choose another folder";
    case EROFS:
      return cause + ": choose a folder on a disk that can be written";
    case ENOENT:
    case ENOTDIR:
      return cause + ": check the name and that the folder exists";
    default:
      return cause;
  }
}

Result<std::vector<std::byte>> read_file(const fs::path& path, std::uint64_t max_byte_count) {
  // O_NONBLOCK: opening a pipe that nobody writes must not wait.
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!file.is_open()) return tl::unexpected(read_error(path, errno));
  struct stat status {};
  if (::fstat(file.number(), &status) != 0) return tl::unexpected(read_error(path, errno));
  if (!S_ISREG(status.st_mode)) {
    return tl::unexpected(InputError{InputFault::kUnreadable, path.string(), "",
                                     "is not a regular file; expected a file with data"});
  }
  const auto byte_count = static_cast<std::uint64_t>(status.st_size);
  if (byte_count > max_byte_count) {
    return tl::unexpected(InputError{InputFault::kUnreadable, path.string(), "",
                                     "has " + std::to_string(byte_count) +
                                         " bytes; expected at most " +
                                         std::to_string(max_byte_count) + " for what it holds"});
  }
  std::vector<std::byte> bytes(byte_count);
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t count = ::read(file.number(), bytes.data() + done, bytes.size() - done);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return tl::unexpected(read_error(path, errno));
    if (count == 0) break;  // somebody shortened it meanwhile: what is left gets judged
    done += static_cast<std::size_t>(count);
  }
  bytes.resize(done);
  return bytes;
}

Result<std::string> read_text(const fs::path& path) {
  const auto bytes = read_file(path, kLargestTextBytes);
  if (!bytes) return tl::unexpected(bytes.error());
  return std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size());
}

std::string sha256_hex(const std::vector<std::byte>& bytes) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned digest_size = 0;
  const int is_done =
      EVP_Digest(bytes.data(), bytes.size(), digest.data(), &digest_size, EVP_sha256(), nullptr);
  check(is_done == 1 && digest_size == 32, "libcrypto has no SHA-256");
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string hex;
  for (unsigned i = 0; i < digest_size; ++i) {
    hex += kDigits[digest[i] >> 4U];
    hex += kDigits[digest[i] & 15U];
  }
  return hex;
}

Result<void> write_file_atomically(const fs::path& path, const std::vector<std::byte>& bytes) {
  fs::path temporary = path;
  temporary += ".tmp";
  int error_number = write_and_sync(temporary, bytes);
  if (error_number == 0 && ::rename(temporary.c_str(), path.c_str()) != 0) error_number = errno;
  if (error_number != 0) {
    ::unlink(temporary.c_str());
    return tl::unexpected(write_error(path, error_number));
  }
  error_number = sync_folder(path.parent_path());
  if (error_number != 0) return tl::unexpected(write_error(path, error_number));
  return {};
}

Result<void> put_in_place(const fs::path& written, const fs::path& path) {
  Descriptor file(::open(written.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  if (!file.is_open() || ::fdatasync(file.number()) != 0 ||
      ::rename(written.c_str(), path.c_str()) != 0)
    return tl::unexpected(write_error(path, errno));
  if (const int error_number = sync_folder(path.parent_path()); error_number != 0)
    return tl::unexpected(write_error(path, error_number));
  return {};
}

Result<fs::path> resolve_in_session(const fs::path& session, const std::string& name,
                                    const std::string& place) {
  const auto refuse = [&](InputFault fault, const std::string& why) {
    return tl::unexpected(
        InputError{fault, (session / "session.json").string(), place,
                   "names \"" + name + "\", but " + why +
                       "; expected a file name relative to the session folder that stays in it"});
  };
  if (const std::string objection = objection_to_name(name); !objection.empty()) {
    return refuse(InputFault::kInvalid, objection);
  }
  std::error_code error;
  const fs::path folder = fs::canonical(session, error);
  if (error) return tl::unexpected(read_error(session, error.value()));

  fs::path prefix = session;
  for (const fs::path& part : fs::path(name)) {
    prefix /= part;
    // weakly_canonical does not look through a link to nothing, yet writing would follow it.
    if (fs::is_symlink(prefix, error) && !fs::exists(prefix, error)) {
      return refuse(InputFault::kNotFound, "that is a link to nothing");
    }
  }
  const fs::path target = fs::weakly_canonical(session / name, error);
  if (error) return tl::unexpected(read_error(session / name, error.value()));
  if (!is_inside(folder, target)) {
    return refuse(InputFault::kInvalid, "that leads out of the session folder by a link");
  }
  return session / name;
}

}  // namespace estimation
