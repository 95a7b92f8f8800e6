// The error budget: what one imperfection of a rig does to a fit that is not told of it, and what
// is left once it is told.
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <numeric>

#include "estimation/models/dipole.h"
#include "tests/bench/errors.h"
#include "tests/bench/estimation_bench.h"
#include "tests/bench/methods.h"
#include "tests/bench/sweep_errors_bench.h"

namespace bench {
namespace {

using estimation::truth::PeriodicCurve;

constexpr double kPitchMm = 0.3;
constexpr std::size_t kPixels = 256;  // positions in the stripes
constexpr int kFactors = 41;

struct Imperfection {
  std::string name;
  double blur_px = 0;
  double drift_px = 0;
  bool is_shuffled = false;
  double gain = 1, pitch_gain = 1;
  double nonlinearity_frac = 0, ambient = 0;
  bool is_indirect_free = true;
  bool is_corrected = false;  // the fit is told of blur and drift
};

// The order in which shifts are shown: multiples of the golden section, so that neighbours in time
// are far apart in phase.
std::vector<int> shuffled(std::size_t count) {
  std::vector<int> shift_at(count), order(count);
  std::iota(shift_at.begin(), shift_at.end(), 0);
  std::sort(shift_at.begin(), shift_at.end(), [](int a, int b) {
    const auto key = [](int i) { return std::fmod(0.6180339887498949 * i, 1.0); };
    return key(a) < key(b);
  });
  for (std::size_t place = 0; place < count; ++place)
    order[static_cast<std::size_t>(shift_at[place])] = static_cast<int>(place);
  return order;
}

void tell_blur(double sigma_px, PixelSet& pixels) {
  pixels.factor_count = kFactors;
  pixels.factor_im.assign(kFactors * pixels.stride, 0);
  for (int n = 0; n < kFactors; ++n) {
    const double k = 2 * std::numbers::pi * n / pixels.shape.period_px;
    pixels.factor_re.insert(pixels.factor_re.end(), pixels.stride,
                            static_cast<float>(std::exp(-0.5 * std::pow(k * sigma_px, 2))));
  }
}

// The model takes position - shift - offset: a pixel that moves by +m sees its offset at -m.
void tell_drift(double drift_px, const std::vector<int>& order, PixelSet& pixels) {
  const auto last = static_cast<double>(pixels.shifts_px.size() - 1);
  for (const int place : order)
    pixels.offset_px.push_back(static_cast<float>(-drift_px * (place / last - 0.5)));
}

Errors errors_with(Bench& bench, const estimation::ScatteringModel& model,
                   const estimation::HarmonicTable& table, const estimation::Coefficients& medium,
                   const Imperfection& wrong) {
  PixelPlan plan = bench.plan(kPitchMm, 0, 40, 1, kPixels);
  Subject subject = bench.subject(medium, kPitchMm);
  const PeriodicCurve blurred = subject.curve->blurred(wrong.blur_px);
  subject.curve = &blurred;
  plan.subjects = {subject};
  plan.sensor.is_noisy = false;
  plan.sensor.nonlinearity_frac = wrong.nonlinearity_frac;
  plan.view = {.ambient = wrong.ambient, .drift_px = wrong.drift_px, .gain = wrong.gain};
  plan.order = shuffled(plan.shifts_px.size());
  if (!wrong.is_shuffled) std::iota(plan.order.begin(), plan.order.end(), 0);
  PixelSet pixels = simulate(plan);
  // The camera that is not linear also measured the white standard, in the short exposure.
  for (float& full_signal : pixels.full_signal)
    full_signal *= static_cast<float>(1 - wrong.nonlinearity_frac * plan.sensor.white_frac);
  if (wrong.is_corrected && wrong.blur_px > 0) tell_blur(wrong.blur_px, pixels);
  if (wrong.is_corrected && wrong.drift_px != 0) tell_drift(wrong.drift_px, plan.order, pixels);
  const auto ours =
      likelihood("likelihood", model, table,
                 {.indirect = wrong.is_indirect_free ? estimation::IndirectLight::kFree
                                                     : estimation::IndirectLight::kZero});
  std::vector<Estimate> estimates;
  ours->prepare(pixels);
  ours->run(pixels, estimates);
  for (Estimate& estimate : estimates) estimate.translucency_px *= wrong.pitch_gain;
  return errors_of(pixels, estimates, &model);
}

// The mean over positions, and how far a pixel scatters around it with its position.
std::string bias_and_spread(const Errors::Quantity& quantity) {
  std::string text = quantity.bias >= 0 ? "+" : "";
  text.append(percent(quantity.bias, 1));
  if (quantity.sd > 5e-4) text.append(" (").append(percent(quantity.sd, 1)).append(")");
  return text;
}

std::string cell(const Errors& errors) {
  std::string text = bias_and_spread(errors.translucency);
  text.append(" / ").append(bias_and_spread(errors.sigma_a));
  text.append(" / ").append(bias_and_spread(errors.sigma_s_prime));
  const double chi_square = errors.median_chi_square;
  text.append(" [").append(chi_square < 5e-4 ? "0" : digits(chi_square, 2)).append("]");
  if (errors.valid_frac < 1)
    text.append(" valid ").append(percent(errors.valid_frac, 0)).append("%");
  return text;
}

std::vector<Imperfection> imperfections() {
  return {
      {.name = "none"},
      {.name = "irradiance or cosine off by 1%", .gain = 1.01},
      {.name = "pitch off by 1%", .pitch_gain = 1.01},
      {.name = "blur, sigma 0.5 px", .blur_px = 0.5},
      {.name = "the same, corrected", .blur_px = 0.5, .is_corrected = true},
      {.name = "blur, sigma 1 px", .blur_px = 1},
      {.name = "the same, corrected", .blur_px = 1, .is_corrected = true},
      {.name = "blur, sigma 2 px", .blur_px = 2},
      {.name = "the same, corrected", .blur_px = 2, .is_corrected = true},
      {.name = "drift of 0.5 px, in order", .drift_px = 0.5},
      {.name = "drift of -0.5 px, in order", .drift_px = -0.5},
      {.name = "drift of 0.5 px, in order, corrected", .drift_px = 0.5, .is_corrected = true},
      {.name = "drift of 0.5 px, shuffled", .drift_px = 0.5, .is_shuffled = true},
      {.name = "the same, corrected", .drift_px = 0.5, .is_shuffled = true, .is_corrected = true},
      {.name = "camera nonlinearity 1%", .nonlinearity_frac = 0.01},
      {.name = "ambient 0.002 a phase, B free", .ambient = 0.002},
      {.name = "the same, B fixed at zero", .ambient = 0.002, .is_indirect_free = false}};
}

}  // namespace

void show_error_budget(Bench& bench) {
  const estimation::Dipole dipole(kEta);
  const estimation::HarmonicTable table = wide_harmonic_table(dipole, {});
  Table budget{.name = "budget",
               .title =
                   "Bias of l_d / sigma_a / sigma_s' in percent from one imperfection [reduced "
                   "chi-square it adds to one pixel]",
               .columns = {"imperfection"}};
  std::vector<NamedMedium> media;
  for (const char* name : {"female cheek red", "female cheek green", "male stubble blue"})
    for (const NamedMedium& named : bench.media)
      if (named.name == name) media.push_back(named);
  for (const NamedMedium& named : media) budget.columns.push_back(named.name);
  for (const Imperfection& wrong : imperfections()) {
    budget.rows.push_back({wrong.name});
    for (const NamedMedium& named : media)
      budget.rows.back().push_back(cell(errors_with(bench, dipole, table, named.medium, wrong)));
  }
  bench.report.text(
      "Dipole truth by spatial quadrature without noise, 256 positions in the stripes, 40 shifts, "
      "pitch 0.3 mm, B 0 in truth and free in the fit unless said. Corrected: the fit is given the "
      "blur's transfer or each frame's effective shift. Nonlinearity: the signal loses 1% of "
      "itself "
      "at full well, in the white standard too. In round brackets: how far a pixel scatters with "
      "its position in the stripes.");
  bench.report.table(budget);
  show_estimated_sweep_errors(bench, media);
}

}  // namespace bench
