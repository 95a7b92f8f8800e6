#include "hw_sim/trigger_box_model.h"
