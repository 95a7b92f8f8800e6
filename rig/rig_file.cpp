#include "rig/rig_file.h"
