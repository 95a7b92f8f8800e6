#include "hw_sim/devices/ledger_world.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "estimation/base/check.h"

namespace hw_sim {
namespace {

using std::chrono::duration_cast;
using std::chrono::microseconds;

constexpr std::uint64_t kMagic = 0x7373'7269'676c'6564;      // "ssrigled"
constexpr std::uint64_t kHashStart = 0xcbf2'9ce4'8422'2325;  // FNV-1a's, on words instead of bytes
constexpr std::uint64_t kHashFactor = 0x0000'0100'0000'01b3;
constexpr std::size_t kSampleCount =
    static_cast<std::size_t>(LedgerWorld::kWidthPx) * LedgerWorld::kHeightPx;
constexpr std::size_t kWordCount = kSampleCount / 4;  // of 64 bits, four samples each
// magic, trigger number, exposure, segment count, then three a segment, the hash of all last
constexpr std::size_t kHeaderWords = 4;
constexpr std::size_t kSegmentLimit = (kWordCount - kHeaderWords - 1) / 3;
constexpr double kWhite_dn = 50'000;  // under a white picture, whatever the exposure
constexpr std::uint64_t kEverySample = 0x0001'0001'0001'0001;

std::uint64_t hash_words(const std::uint64_t* words, std::size_t count) {
  std::uint64_t hash = kHashStart;
  for (std::size_t i = 0; i < count; ++i) {
    hash = (hash ^ words[i]) * kHashFactor;
    hash ^= hash >> 29;  // FNV on words mixes upwards only
  }
  return hash;
}

// Four samples of what the light was on average.
std::uint64_t grey_word(const Exposure& exposure) {
  double light = 0, time = 1e-9;
  for (const LightSegment& segment : exposure.light) {
    const auto levels = segment.picture->brightness.samples();
    const double mean = std::accumulate(levels.begin(), levels.end(), 0.0) /
                        static_cast<double>(std::max<std::size_t>(levels.size(), 1));
    light += mean / 255 * static_cast<double>(segment.duration.count());
    time += static_cast<double>(segment.duration.count());
  }
  return kEverySample * static_cast<std::uint64_t>(std::lround(kWhite_dn * light / time));
}

}  // namespace

std::uint64_t content_hash(const estimation::Image<unsigned char>& picture) {
  const auto samples = picture.samples();
  std::vector<std::uint64_t> words((samples.size() + 7) / 8, 0);
  std::memcpy(words.data(), samples.data(), samples.size());
  return hash_words(words.data(), words.size());
}

void LedgerWorld::expose(const Exposure& exposure,
                         estimation::ImageView<std::uint16_t> frame_dn) const {
  estimation::check(frame_dn.height_px == kHeightPx && frame_dn.width_px == kWidthPx &&
                        frame_dn.channel_count == 1,
                    "the ledger world is 64 x 48 px, mono");
  std::vector<std::uint64_t> words(kWordCount, 0);
  const std::size_t segment_count = std::min(exposure.light.size(), kSegmentLimit);
  words[0] = kMagic;
  words[1] = exposure.trigger_number;
  words[2] = static_cast<std::uint64_t>(exposure.duration.count());
  words[3] = segment_count;
  for (std::size_t i = 0; i < segment_count; ++i) {
    const LightSegment& segment = exposure.light[i];
    words[kHeaderWords + 3 * i] = segment.picture->id;
    words[kHeaderWords + 3 * i + 1] = content_hash(segment.picture->brightness);
    words[kHeaderWords + 3 * i + 2] =
        static_cast<std::uint64_t>(duration_cast<microseconds>(segment.duration).count());
  }
  const std::size_t identity_end = kHeaderWords + 3 * segment_count;
  std::fill(words.begin() + static_cast<std::ptrdiff_t>(identity_end), words.end(),
            grey_word(exposure));
  words.back() = hash_words(words.data(), kWordCount - 1);
  for (int row = 0; row < kHeightPx; ++row)
    std::memcpy(frame_dn.row(row).data(),
                reinterpret_cast<const unsigned char*>(words.data()) +
                    static_cast<std::size_t>(row) * kWidthPx * sizeof(std::uint16_t),
                frame_dn.row(row).size_bytes());
}

std::optional<FrameIdentity> decode_identity(estimation::ImageView<const std::uint16_t> frame_dn) {
  if (frame_dn.height_px != LedgerWorld::kHeightPx || frame_dn.width_px != LedgerWorld::kWidthPx ||
      frame_dn.channel_count != 1)
    return std::nullopt;
  std::vector<std::uint64_t> words(kWordCount, 0);
  for (int row = 0; row < LedgerWorld::kHeightPx; ++row)
    std::memcpy(reinterpret_cast<unsigned char*>(words.data()) +
                    static_cast<std::size_t>(row) * LedgerWorld::kWidthPx * sizeof(std::uint16_t),
                frame_dn.row(row).data(), frame_dn.row(row).size_bytes());
  const bool is_whole = words[0] == kMagic && words[3] <= kSegmentLimit &&
                        words.back() == hash_words(words.data(), kWordCount - 1);
  if (!is_whole) return std::nullopt;
  FrameIdentity identity;
  identity.trigger_number = words[1];
  identity.exposure = microseconds(words[2]);
  for (std::size_t i = 0; i < words[3]; ++i)
    identity.light.push_back({words[kHeaderWords + 3 * i], words[kHeaderWords + 3 * i + 1],
                              microseconds(words[kHeaderWords + 3 * i + 2])});
  return identity;
}

}  // namespace hw_sim
