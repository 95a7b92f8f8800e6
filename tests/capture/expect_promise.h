// What every capture under faults keeps, whatever becomes of it.
#pragma once

#include <gtest/gtest.h>

#include "tests/capture/fault_matrix.h"

namespace capture {

inline void expect_promise(const Trial& trial) {
  EXPECT_EQ(trial.wrong_frame_count, 0);
  EXPECT_FALSE(trial.is_falsely_complete);
  EXPECT_FALSE(trial.is_hung);
  if (trial.outcome == Outcome::kFailed) {
    EXPECT_FALSE(trial.text.empty());
  }
}

}  // namespace capture
