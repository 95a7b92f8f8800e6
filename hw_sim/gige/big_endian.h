// Big-endian words in byte buffers, as GVCP and GVSP have them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>

namespace hw_sim {

inline std::uint16_t get16(const std::uint8_t* at) {
  return static_cast<std::uint16_t>((at[0] << 8) | at[1]);
}
inline std::uint32_t get32(const std::uint8_t* at) {
  return (std::uint32_t{get16(at)} << 16) | get16(at + 2);
}
inline std::uint64_t get64(const std::uint8_t* at) {
  return (std::uint64_t{get32(at)} << 32) | get32(at + 4);
}
inline void put16(std::uint8_t* at, std::uint32_t value) {
  at[0] = static_cast<std::uint8_t>(value >> 8);
  at[1] = static_cast<std::uint8_t>(value);
}
inline void put32(std::uint8_t* at, std::uint32_t value) {
  put16(at, value >> 16);
  put16(at + 2, value);
}
inline void put64(std::uint8_t* at, std::uint64_t value) {
  put32(at, static_cast<std::uint32_t>(value >> 32));
  put32(at + 4, static_cast<std::uint32_t>(value));
}

// Appends words to a buffer that is large enough by construction.
class WordWriter {
 public:
  explicit WordWriter(std::uint8_t* at) : start_(at), at_(at) {}
  void u16(std::uint32_t value) { put16(std::exchange(at_, at_ + 2), value); }
  void u32(std::uint32_t value) { put32(std::exchange(at_, at_ + 4), value); }
  void u64(std::uint64_t value) { put64(std::exchange(at_, at_ + 8), value); }
  std::size_t size() const { return static_cast<std::size_t>(at_ - start_); }

 private:
  std::uint8_t* start_;
  std::uint8_t* at_;
};

}  // namespace hw_sim
