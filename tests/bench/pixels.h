// Simulated pixels for estimators to compete on: samples as a camera would give them, with the
// truth beside them.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "estimation/profile/likelihood.h"
#include "tests/estimation/truth/sensor.h"
#include "tests/estimation/truth/stripe_response.h"

namespace bench {

struct NamedMedium {
  std::string name;  // "female cheek red"
  estimation::Coefficients medium;
};

// The 24 of the paper's Table 2: two subjects, four rows each (means included, standard deviations
// not), three colours. Ends the program if `file` cannot be read.
std::vector<NamedMedium> table_2(const std::string& file);

// `count` of a period's shifts, evenly spaced.
std::vector<int> even_shifts(int period_px, int count);

// What a pixel shows: the curve of its stripe response and what an estimate is held against.
struct Subject {
  const estimation::truth::PeriodicCurve* curve = nullptr;
  estimation::Coefficients medium;
  double pitch_mm = 0;
  double diffuse_reflectance = 0;  // by the model of the truth
  double translucency_mm = 0;
};

struct PixelPlan {
  std::vector<Subject> subjects;  // pixel i shows subject i mod their number
  std::size_t count = 0;
  estimation::StripeShape shape;
  std::vector<int> shifts_px;
  estimation::truth::Sensor sensor;
  estimation::truth::View view;     // u_px is drawn for each pixel
  std::vector<int> order = {};      // of the shifts in time; empty: as they are listed
  double position_error_px = 0.05;  // what is known of u beforehand: uniform up to this
  std::uint64_t seed = 1;
};

// Both layouts, so that no estimator pays for another's.
struct PixelSet {
  estimation::StripeShape shape;
  std::vector<int> shifts_px;
  std::vector<estimation::MergedNoise> noise;
  std::vector<Subject> subjects;
  std::size_t count = 0, stride = 0;
  std::vector<float> samples;                   // [shift][stride] DN/us
  std::vector<float> samples_by_pixel;          // [pixel][shift]
  std::vector<float> position_px, full_signal;  // [stride]
  std::vector<double> true_u_px;
  double indirect = 0;  // B of all
  // What the estimators are told about optics and motion; empty: perfect optics, no motion.
  std::vector<float> factor_re = {}, factor_im = {};  // [n = 0..factor_count - 1][stride]
  int factor_count = 0;
  std::vector<float> offset_px = {};  // [shift]

  const Subject& subject(std::size_t pixel) const { return subjects[pixel % subjects.size()]; }
  estimation::PixelBatch batch(std::size_t first, std::size_t block_count) const;
};

// In the caller's oneTBB arena; the same numbers for any number of threads.
PixelSet simulate(const PixelPlan& plan);

// What an estimator says of a pixel.
struct Estimate {
  double diffuse_reflectance = 0, translucency_px = 0, indirect = 0;
  double u_px = 0;  // projector coordinate; zero from estimators that do not fit it
  // Standard deviations of ln R_d and ln l_d as stated; zero from estimators that state none.
  double log_reflectance_sd = 0, log_translucency_sd = 0;
  double reduced_chi_square = 0;
  bool is_valid = false;
};

}  // namespace bench
