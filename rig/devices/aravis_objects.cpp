#include "rig/devices/aravis_objects.h"

#include <glib-object.h>

namespace rig {

void unref_object(void* object) { g_object_unref(object); }

}  // namespace rig
