#include "hw_sim/world/transport_cache.h"

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <sstream>
#include <system_error>
#include <vector>

namespace hw_sim {

namespace {

// Raise it whenever the transport's code changes what it computes or how it is stored.
constexpr std::uint64_t kVersion = 7;

// 64 bits over 8 bytes at a time: for damage and for content, not against an adversary.
class Hash {
 public:
  void add(const void* data, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(data);
    for (; size >= 8; bytes += 8, size -= 8) {
      std::uint64_t word = 0;
      std::memcpy(&word, bytes, 8);
      mix(word);
    }
    std::uint64_t tail = size;
    for (std::size_t i = 0; i < size; ++i) tail = (tail << 8) | bytes[i];
    mix(tail);
  }
  void add(double value) { add(&value, sizeof(value)); }
  std::uint64_t value() const { return state_; }

 private:
  void mix(std::uint64_t word) {
    state_ = (state_ ^ word) * 0x9FB21C651E98DF25U;
    state_ ^= state_ >> 32;
  }
  std::uint64_t state_ = 0xCBF29CE484222325U;
};

// Hashes what goes through it on its way to or from a file.
class HashedBuffer final : public std::streambuf {
 public:
  explicit HashedBuffer(std::streambuf* file) : file_(file) {}
  std::uint64_t value() const { return hash_.value(); }

 protected:
  std::streamsize xsputn(const char* data, std::streamsize size) override {
    hash_.add(data, static_cast<std::size_t>(size));
    return file_->sputn(data, size);
  }
  std::streamsize xsgetn(char* data, std::streamsize size) override {
    const std::streamsize got = file_->sgetn(data, size);
    hash_.add(data, static_cast<std::size_t>(got));
    return got;
  }

 private:
  std::streambuf* file_;
  Hash hash_;
};

}  // namespace

std::string cache_key(const estimation::CameraInfo& camera,
                      const estimation::ProjectorInfo& projector,
                      const estimation::Calibration& calibration, const std::string& scene_name,
                      ScatteringModel model, int photons_per_angle,
                      const std::vector<SeenSample>& samples) {
  Hash hash;
  hash.add(static_cast<double>(kVersion));
  hash.add(model == ScatteringModel::kDipole ? 0.0 : static_cast<double>(photons_per_angle));
  hash.add(scene_name.data(), scene_name.size());
  for (const int value :
       {camera.width_px, camera.height_px, camera.roi_x_px, camera.roi_y_px,
        static_cast<int>(camera.pixel_format.filter), projector.width_px, projector.height_px})
    hash.add(static_cast<double>(value));
  for (const estimation::Lens* lens : {&calibration.camera, &calibration.projector}) {
    hash.add(lens->K.val, sizeof(lens->K.val));
    for (const double value : lens->distortion) hash.add(value);
  }
  hash.add(calibration.projector_from_camera.val, sizeof(calibration.projector_from_camera.val));
  hash.add(calibration.projector_from_camera_mm.val,
           sizeof(calibration.projector_from_camera_mm.val));
  hash.add(calibration.irradiance->reference_distance_mm.value_or(0));
  const std::uint64_t inputs = hash.value();
  // The surface and its materials enter as what the camera sees of them.
  for (const SeenSample& sample : samples) {
    hash.add(sample.point_mm.data(), sizeof(sample.point_mm));
    hash.add(sample.scattering.sigma_a_per_mm);
    hash.add(sample.scattering.sigma_s_prime_per_mm);
  }
  std::ostringstream text;
  text << std::hex << std::setfill('0') << std::setw(16) << inputs << std::setw(16) << hash.value();
  return text.str();
}

TransportCache::TransportCache(const std::filesystem::path& folder, const std::string& key) {
  if (!folder.empty()) file_ = folder / ("transport-" + key);
}

bool TransportCache::load(Transport& transport, const std::vector<SeenSample>& samples,
                          const ProjectorLight& light, const ScatterTable* table) const {
  if (file_.empty()) return false;
  std::ifstream file(file_, std::ios::binary);
  if (!file) return false;
  HashedBuffer buffer(file.rdbuf());
  std::istream in(&buffer);
  Transport loaded;
  if (!loaded.load(in, samples, light, table)) return false;
  const std::uint64_t computed = buffer.value();
  std::uint64_t stored = 0;
  file.read(reinterpret_cast<char*>(&stored), sizeof(stored));
  if (!file || stored != computed || file.peek() != std::ifstream::traits_type::eof()) return false;
  transport = std::move(loaded);
  return true;
}

void TransportCache::save(const Transport& transport) const {
  if (file_.empty()) return;
  std::error_code error;
  std::filesystem::create_directories(file_.parent_path(), error);
  // The process id keeps two programs that compute the same scene from sharing a temporary file.
  const std::filesystem::path temporary = file_.string() + "." + std::to_string(getpid()) + ".tmp";
  bool is_written = false;
  {
    std::ofstream file(temporary, std::ios::binary);
    HashedBuffer buffer(file.rdbuf());
    std::ostream out(&buffer);
    transport.save(out);
    const std::uint64_t checksum = buffer.value();
    file.write(reinterpret_cast<const char*>(&checksum), sizeof(checksum));
    file.flush();
    is_written = out.good() && file.good();
  }
  if (is_written) std::filesystem::rename(temporary, file_, error);
  if (!is_written || error) std::filesystem::remove(temporary, error);
}

}  // namespace hw_sim
