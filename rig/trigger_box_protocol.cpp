#include "rig/trigger_box_protocol.h"
