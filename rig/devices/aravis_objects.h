// What GLib hands out, each let go of by its owner. Internal to the Aravis adapter.
#pragma once

#include <memory>

struct _ArvCamera;
struct _ArvStream;
struct _ArvChunkParser;

namespace rig {

void unref_object(void* object);

template <typename T>
struct GObjectUnref {
  void operator()(T* object) const { unref_object(object); }
};
template <typename T>
using GObjectPtr = std::unique_ptr<T, GObjectUnref<T>>;

}  // namespace rig
