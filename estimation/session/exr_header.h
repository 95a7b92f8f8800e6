// Whether the headers of an EXR file are sound. Private to this folder's .cpp files.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace estimation {

// Why OpenEXR had better not see the file; "" if it may. OpenEXR allocates (and for texts also
// fills) what an attribute says it holds before it reads it, up to 2 GiB; and reads values of a
// known type by that type's size, so that a wrong one makes it take values for names. Here every
// attribute ends within the file and is as long as its type.
std::string objection_to_exr_headers(const std::vector<std::byte>& bytes);

}  // namespace estimation
