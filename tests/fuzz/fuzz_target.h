// What every fuzz target is: libFuzzer's entry point, which the test fuzz_corpus calls too. A
// target returns 0 and ends the process (estimation::check, a sanitizer) for a finding. A finding
// is a crash, undefined behaviour, a hang, memory beyond all measure, an exception, an error that
// says nothing, or accepted input that does not come back as it was.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/base/check.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace fuzz {

inline std::string_view text_of(const std::uint8_t* data, std::size_t size) {
  return {reinterpret_cast<const char*>(data), size};
}

// Takes plain numbers from the input, zeros when it is used up.
class Source {
 public:
  Source(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

  template <typename Number>
  Number take() {
    Number number{};
    const std::size_t count = size_ < sizeof number ? size_ : sizeof number;
    if (count > 0) std::memcpy(&number, data_, count);
    data_ += count;
    size_ -= count;
    return number;
  }
  bool is_empty() const { return size_ == 0; }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

// One input in eight, by its content: for a second look that costs as much as the first.
inline bool is_in_share(const std::uint8_t* data, std::size_t size) {
  std::uint32_t hash = 2166136261U;  // FNV-1a
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ data[i]) * 16777619U;
  return (hash >> 16) % 8 == 0;
}

inline void require_message(const std::string& text, std::string_view file) {
  estimation::check(text.size() > file.size() && text.find(file) != std::string::npos,
                    "an error names the file and says what is wrong");
}

}  // namespace fuzz
