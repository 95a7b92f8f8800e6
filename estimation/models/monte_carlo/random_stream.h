// Random numbers for photon walks: xoshiro256++ (Blackman and Vigna), seeded per stream, so that a
// result depends on its seed and the number of streams, never on which thread ran which.
#pragma once

#include <cstdint>

namespace estimation {

class RandomStream {
 public:
  // Streams of one seed are independent (their states come from different places of splitmix64).
  RandomStream(std::uint64_t seed, std::uint64_t stream) {
    std::uint64_t state = mix(seed + 0x9e3779b97f4a7c15u) ^ mix(stream * 0xd1342543de82ef95u + 1);
    for (std::uint64_t& word : state_) word = mix(state += 0x9e3779b97f4a7c15u);
  }

  std::uint64_t bits() {
    const std::uint64_t result = rotate(state_[0] + state_[3], 23) + state_[0];
    const std::uint64_t shifted = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= shifted;
    state_[3] = rotate(state_[3], 45);
    return result;
  }

  // In (0, 1), never either end.
  double uniform() { return (static_cast<double>(bits() >> 12) + 0.5) * 0x1p-52; }

 private:
  static std::uint64_t rotate(std::uint64_t word, int count) {
    return word << count | word >> (64 - count);
  }
  // The output function of splitmix64.
  static std::uint64_t mix(std::uint64_t word) {
    word = (word ^ word >> 30) * 0xbf58476d1ce4e5b9u;
    word = (word ^ word >> 27) * 0x94d049bb133111ebu;
    return word ^ word >> 31;
  }

  std::uint64_t state_[4];
};

}  // namespace estimation
