// How reading data fails: which file, which place in it, what was expected there.
#pragma once

#include <string>
#include <tl/expected.hpp>

namespace estimation {

enum class InputFault {
  kInvalid,      // wrong content: missing key, wrong type, wrong range, wrong size
  kNotFound,     // a file the session names is not there
  kUnreadable,   // there, but truncated, damaged or not permitted
  kUnwritable,   // a result could not be stored (permission, disk full)
  kInsufficient  // sound data, but too little of it for what was asked
};

// One sentence a person can act on: text() is "FILE: PLACE: what was found; expected ...".
struct InputError {
  InputFault fault = InputFault::kInvalid;
  std::string file;         // path as the caller gave it, relative names resolved
  std::string place;        // JSON pointer ("/camera/width"), frame, pixel ...; may be empty
  std::string expectation;  // what is wrong and what was expected instead, with the remedy

  std::string text() const {
    std::string line = file;
    if (!place.empty()) line += line.empty() ? place : ": " + place;
    return line.empty() ? expectation : line + ": " + expectation;
  }
};

template <typename T>
using Result = tl::expected<T, InputError>;

}  // namespace estimation
