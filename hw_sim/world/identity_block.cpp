#include "hw_sim/world/identity_block.h"

#include <algorithm>
#include <bitset>
#include <cstddef>

namespace hw_sim {

namespace {

constexpr std::size_t kBitCount =
    std::size_t{IdentityBlockLayout::kWidthPx} * IdentityBlockLayout::kHeightPx;
using Bits = std::bitset<kBitCount>;
constexpr std::uint64_t kMagic = 0xB5;
constexpr int kMagicBits = 8, kTriggerBits = 32, kExposureBits = 32, kIdBits = 64, kHashBits = 32,
              kShareBits = 8, kCountBits = 8, kChecksumBits = 32;
static_assert(kMagicBits + kTriggerBits + kExposureBits + kIdBits + kHashBits + kShareBits +
                  kCountBits + kChecksumBits ==
              kBitCount);

// Takes or gives fields one after the other.
class Fields {
 public:
  explicit Fields(Bits bits = {}) : bits_(bits) {}
  void put(std::uint64_t value, int count) {
    for (int i = 0; i < count; ++i) bits_[next_++] = (value >> i & 1) != 0;
  }
  std::uint64_t take(int count) {
    std::uint64_t value = 0;
    for (int i = 0; i < count; ++i) value |= static_cast<std::uint64_t>(bits_[next_++]) << i;
    return value;
  }
  const Bits& bits() const { return bits_; }

 private:
  Bits bits_;
  std::size_t next_ = 0;
};

std::uint32_t folded(std::uint64_t hash) { return static_cast<std::uint32_t>(hash ^ (hash >> 32)); }

// FNV-1a.
class Hash {
 public:
  void add(std::uint64_t value) {
    state_ = (state_ ^ value) * 0x0000'0100'0000'01b3;
    state_ ^= state_ >> 29;
  }
  std::uint32_t value() const { return folded(state_); }

 private:
  std::uint64_t state_ = 0xcbf2'9ce4'8422'2325;
};

// Of everything before the checksum.
std::uint32_t checksum(const Bits& bits) {
  Hash hash;
  for (std::size_t i = 0; i + kChecksumBits < kBitCount; ++i) hash.add(bits[i] ? 2 : 1);
  return hash.value();
}

Bits encoded(const IdentityBlock& identity) {
  Fields fields;
  fields.put(kMagic, kMagicBits);
  fields.put(identity.trigger_number, kTriggerBits);
  fields.put(static_cast<std::uint64_t>(identity.exposure.count()), kExposureBits);
  fields.put(identity.picture_id, kIdBits);
  fields.put(identity.picture_hash, kHashBits);
  fields.put(static_cast<std::uint64_t>(identity.share_of_255), kShareBits);
  fields.put(static_cast<std::uint64_t>(identity.picture_count), kCountBits);
  fields.put(checksum(fields.bits()), kChecksumBits);
  return fields.bits();
}

// The block's pixel of each bit, by columns.
int row_of(std::size_t bit) { return static_cast<int>(bit) % IdentityBlockLayout::kHeightPx; }
int col_of(std::size_t bit) { return static_cast<int>(bit) / IdentityBlockLayout::kHeightPx; }

bool has_room(int height_px, int width_px) {
  return height_px >= IdentityBlockLayout::kHeightPx && width_px >= IdentityBlockLayout::kWidthPx;
}

}  // namespace

std::uint32_t picture_hash(const estimation::Image<unsigned char>& brightness) {
  Hash hash;
  hash.add(static_cast<std::uint64_t>(brightness.width_px()));
  const auto samples = brightness.samples();
  std::size_t i = 0;
  for (; i + 8 <= samples.size(); i += 8) {
    std::uint64_t word = 0;
    for (std::size_t k = 0; k < 8; ++k) word |= std::uint64_t{samples[i + k]} << (8 * k);
    hash.add(word);
  }
  for (; i < samples.size(); ++i) hash.add(samples[i]);
  return hash.value();
}

void IdentityBlockLayout::write(const IdentityBlock& identity,
                                estimation::ImageView<std::uint16_t> frame_dn) const {
  if (!has_room(frame_dn.height_px, frame_dn.width_px)) return;
  const Bits bits = encoded(identity);
  for (std::size_t bit = 0; bit < kBitCount; ++bit)
    for (int channel = 0; channel < frame_dn.channel_count; ++channel)
      frame_dn.at(row_of(bit), col_of(bit), channel) =
          static_cast<std::uint16_t>(bits[bit] ? set_dn() : black_level_dn);
}

std::optional<IdentityBlock> IdentityBlockLayout::read(
    estimation::ImageView<const std::uint16_t> frame_dn) const {
  if (!has_room(frame_dn.height_px, frame_dn.width_px)) return std::nullopt;
  Bits bits;
  for (std::size_t bit = 0; bit < kBitCount; ++bit)
    bits[bit] = 2 * frame_dn.at(row_of(bit), col_of(bit)) > black_level_dn + set_dn();
  Fields fields(bits);
  if (fields.take(kMagicBits) != kMagic) return std::nullopt;
  IdentityBlock identity;
  identity.trigger_number = static_cast<std::uint32_t>(fields.take(kTriggerBits));
  identity.exposure = std::chrono::microseconds(fields.take(kExposureBits));
  identity.picture_id = fields.take(kIdBits);
  identity.picture_hash = static_cast<std::uint32_t>(fields.take(kHashBits));
  identity.share_of_255 = static_cast<int>(fields.take(kShareBits));
  identity.picture_count = static_cast<int>(fields.take(kCountBits));
  if (fields.take(kChecksumBits) != checksum(bits)) return std::nullopt;
  return identity;
}

}  // namespace hw_sim
