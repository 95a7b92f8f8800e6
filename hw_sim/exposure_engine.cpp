#include "hw_sim/exposure_engine.h"
