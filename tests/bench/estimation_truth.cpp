// Monte Carlo truth: what each model makes of pixels that no model of the estimator made.
#include <cmath>
#include <complex>
#include <numbers>

#include "tests/bench/errors.h"
#include "tests/bench/estimation_bench.h"
#include "tests/bench/methods.h"
#include "tests/estimation/truth/monte_carlo_truth.h"

namespace bench {
namespace {

using estimation::IndirectLight;
using estimation::ScatteringModel;
using estimation::truth::MonteCarloMedium;
using estimation::truth::PeriodicCurve;

constexpr double kPitchMm = 0.3;
constexpr int kFactors = 41;
// Of tables: what the media of both files occupy at this pitch, by any model.
const estimation::ShapeRange kRange{.least = {-3.2, 0.2}, .greatest = {2.2, 3.8}};

// f_n of a flat surface seen as a whole: the share of the light that enters, for a model per flux
// transmitted (the truth's R is; the paper's model has no such factor).
void tell_transmission(const ScatteringModel& model, PixelSet& pixels) {
  const double transmission =
      model.name() == "dipole" ? 1 : estimation::truth::fresnel_transmission(kEta, 1);
  pixels.factor_count = kFactors;
  pixels.factor_re.assign(kFactors * pixels.stride, static_cast<float>(transmission));
  pixels.factor_im.assign(kFactors * pixels.stride, 0);
}

struct Named {
  std::string name;
  std::unique_ptr<ScatteringModel> model;
};

std::vector<Named> models(Report& report) {
  struct Wanted {
    const char* label;
    const char* name;
    double anisotropy;
  };
  std::vector<Named> made;
  for (const Wanted& wanted : {Wanted{"monte_carlo, g 0.8 (right)", "monte_carlo", 0.8},
                               Wanted{"monte_carlo, g 0.9 (wrong)", "monte_carlo", 0.9},
                               Wanted{"dipole", "dipole", 0.8}}) {
    auto model = estimation::make_scattering_model(wanted.name,
                                                   {.eta = kEta, .anisotropy = wanted.anisotropy});
    if (model)
      made.push_back({wanted.label, std::move(*model)});
    else
      report.text(std::string(wanted.label).append(": ").append(model.error().text()));
  }
  return made;
}

PixelSet pixels_of(const Subject& subject, bool is_noisy, std::size_t count) {
  PixelPlan plan;
  plan.count = count;
  plan.shifts_px = even_shifts(40, 40);
  plan.sensor.is_noisy = is_noisy;
  plan.subjects = {subject};
  return simulate(plan);
}

Subject subject_of(const PeriodicCurve& curve, const estimation::Coefficients& medium,
                   double pitch_mm, double diffuse_reflectance) {
  return {.curve = &curve,
          .medium = medium,
          .pitch_mm = pitch_mm,
          .diffuse_reflectance = diffuse_reflectance,
          .translucency_mm = 1 / std::sqrt(3 * medium.sigma_a_per_mm *
                                           (medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm))};
}

PixelSet pixels_of(const PeriodicCurve& curve, const MonteCarloMedium& medium, bool is_noisy,
                   std::size_t count) {
  return pixels_of(subject_of(curve, medium.medium, kPitchMm, medium.at(0)), is_noisy, count);
}

// Without a known R_d: the file has none for the medium as a whole.
PixelSet clean_pixels_of(const PeriodicCurve& curve, const estimation::Coefficients& medium,
                         double pitch_mm) {
  return pixels_of(subject_of(curve, medium, pitch_mm, 1), false, 64);
}

Errors fitted(const ScatteringModel& model, const estimation::HarmonicTable& table,
              PixelSet& pixels, IndirectLight indirect = IndirectLight::kFree) {
  tell_transmission(model, pixels);
  const auto ours = likelihood(model.name(), model, table, {.indirect = indirect});
  std::vector<Estimate> estimates;
  ours->prepare(pixels);
  ours->run(pixels, estimates);
  return errors_of(pixels, estimates, &model);
}

// Standard deviation of R(f) over it from that file's photons (design/science.md): 0.1% near f 0,
// about 1% at 0.5/mm, 3% at 1/mm.
double noise_of_truth(double freq_per_mm) {
  return freq_per_mm < 0.5 ? 0.001 * std::pow(10, freq_per_mm / 0.5)
                           : 0.01 * std::pow(3, (freq_per_mm - 0.5) / 0.5);
}

// The truth as other photons might have given it: independent from harmonic to harmonic.
MonteCarloMedium as_other_photons_say(const MonteCarloMedium& medium, std::uint64_t seed) {
  estimation::truth::PixelRandom random(seed);
  const double spacing_per_mm = 1 / (40 * kPitchMm);
  std::vector<double> draws;
  for (int n = 0; n < 16; ++n) draws.push_back(random.normal());
  MonteCarloMedium other = medium;
  for (std::size_t i = 0; i < other.reflectance.size(); ++i) {
    const double freq_per_mm = static_cast<double>(i) * other.freq_step_per_mm;
    const double place = freq_per_mm / spacing_per_mm;
    const auto n = static_cast<std::size_t>(place);
    other.reflectance[i] *= 1 + noise_of_truth(freq_per_mm) *
                                    std::lerp(draws[n], draws[n + 1], place - std::floor(place));
  }
  return other;
}

// Scatter of the biases over such truths: below it, a bias says nothing about the model.
struct TruthScatter {
  double sigma_a = 0, sigma_s_prime = 0;
};
TruthScatter scatter_of_truth(const Named& named, const estimation::HarmonicTable& harmonics,
                              const MonteCarloMedium& medium, IndirectLight indirect) {
  constexpr int kDraws = 24;
  double sum_a = 0, squares_a = 0, sum_s = 0, squares_s = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const MonteCarloMedium other = as_other_photons_say(medium, 77U + static_cast<unsigned>(draw));
    const PeriodicCurve curve =
        monte_carlo_curve(other, {}, kPitchMm, estimation::truth::fresnel_transmission(kEta, 1));
    PixelSet clean = pixels_of(curve, medium, false, 16);
    const Errors errors = fitted(*named.model, harmonics, clean, indirect);
    sum_a += errors.sigma_a.bias / kDraws;
    sum_s += errors.sigma_s_prime.bias / kDraws;
    squares_a += errors.sigma_a.bias * errors.sigma_a.bias / kDraws;
    squares_s += errors.sigma_s_prime.bias * errors.sigma_s_prime.bias / kDraws;
  }
  return {.sigma_a = std::sqrt(squares_a - sum_a * sum_a),
          .sigma_s_prime = std::sqrt(squares_s - sum_s * sum_s)};
}

void show_flat(Bench& bench, const std::vector<MonteCarloMedium>& media,
               const std::vector<Named>& all) {
  Table table{
      .name = "truth_flat",
      .title =
          "Flat, normal incidence, R(f) by an independent Monte Carlo code (g 0.8), B 0 "
          "in truth: bias in percent, +- what that code's own photons leave open",
      .columns = {"medium", "l_d / px", "model", "sigma_a, B free", "sigma_s', B free", "B found",
                  "sigma_a, B = 0", "sigma_s', B = 0", "valid %", "chi-square of a noisy pixel"}};
  for (const Named& named : all) {
    const estimation::HarmonicTable harmonics(*named.model, {}, kRange, 40);
    const bool is_right = &named == all.data();
    const auto with_scatter = [](double bias, double scatter) {
      std::string text = percent(bias, 2);
      return scatter > 0 ? text.append(" +- ").append(percent(scatter, 2)) : text;
    };
    for (const MonteCarloMedium& medium : media) {
      const PeriodicCurve curve =
          monte_carlo_curve(medium, {}, kPitchMm, estimation::truth::fresnel_transmission(kEta, 1));
      PixelSet clean = pixels_of(curve, medium, false, 256);
      const Errors bias = fitted(*named.model, harmonics, clean);
      const Errors fixed = fitted(*named.model, harmonics, clean, IndirectLight::kZero);
      PixelSet noisy = pixels_of(curve, medium, true, 512);
      const Errors scatter = fitted(*named.model, harmonics, noisy);
      TruthScatter open, open_fixed;
      if (is_right) {
        open = scatter_of_truth(named, harmonics, medium, IndirectLight::kFree);
        open_fixed = scatter_of_truth(named, harmonics, medium, IndirectLight::kZero);
      }
      const Subject& subject = clean.subjects.front();
      const bool is_valid = bias.valid_frac > 0.5;
      table.rows.push_back(
          {medium.name, digits(subject.translucency_mm / kPitchMm), named.name,
           is_valid ? with_scatter(bias.sigma_a.bias, open.sigma_a) : "-",
           is_valid ? with_scatter(bias.sigma_s_prime.bias, open.sigma_s_prime) : "-",
           is_valid ? digits(bias.indirect_bias, 2) : "-",
           with_scatter(fixed.sigma_a.bias, open_fixed.sigma_a),
           with_scatter(fixed.sigma_s_prime.bias, open_fixed.sigma_s_prime),
           percent(bias.valid_frac, 0), is_valid ? digits(scatter.median_chi_square) : "-"});
    }
  }
  bench.report.table(table);
}

// f_n of these directions for a material like this one.
void tell_directions(const ScatteringModel& model, const estimation::Directions& directions,
                     double diffuse_reflectance, double translucency_px, PixelSet& pixels) {
  std::vector<double> k_times_l_d;
  for (int n = 0; n < kFactors; ++n)
    k_times_l_d.push_back(2 * std::numbers::pi * n / pixels.shape.period_px * translucency_px);
  std::vector<std::complex<double>> factors(kFactors);
  model.direction_factors(diffuse_reflectance, k_times_l_d, directions, factors);
  pixels.factor_count = kFactors;
  pixels.factor_re.clear();
  pixels.factor_im.clear();
  for (const std::complex<double>& factor : factors) {
    pixels.factor_re.insert(pixels.factor_re.end(), pixels.stride,
                            static_cast<float>(factor.real()));
    pixels.factor_im.insert(pixels.factor_im.end(), pixels.stride,
                            static_cast<float>(factor.imag()));
  }
}

// The directions' factors depend on the material: asked for at a typical skin's, then twice at what
// was found.
Errors fitted_tilted(const ScatteringModel& model, const estimation::HarmonicTable& table,
                     const estimation::Directions& directions, IndirectLight indirect,
                     PixelSet& pixels) {
  const auto ours = likelihood(model.name(), model, table, {.indirect = indirect});
  std::vector<Estimate> estimates;
  double reflectance = 0.4, translucency_px = 4;
  for (int round = 0; round < 3; ++round) {
    tell_directions(model, directions, reflectance, translucency_px, pixels);
    ours->prepare(pixels);
    ours->run(pixels, estimates);
    double count = 0, sum_r = 0, sum_log = 0;
    for (const Estimate& estimate : estimates) {
      if (!estimate.is_valid) continue;
      count += 1;
      sum_r += estimate.diffuse_reflectance;
      sum_log += std::log(estimate.translucency_px);
    }
    if (count == 0) break;
    reflectance = sum_r / count;
    translucency_px = std::exp(sum_log / count);
  }
  return errors_of(pixels, estimates, &model);
}

void show_tilted(Bench& bench) {
  const auto phantoms = estimation::truth::read_tilted_truth(SSRIG_TEST_DATA "/mc_tilted.csv");
  if (!phantoms) {
    bench.report.text(phantoms.error().text());
    return;
  }
  Table table{
      .name = "truth_tilted",
      .title =
          "Flat phantoms tilted in an independent Monte Carlo code (g 0.8), known geometry, "
          "B 0 in truth: bias in percent",
      .columns = {"medium", "incidence, deg", "exit, deg", "model", "sigma_a, B = 0",
                  "sigma_s', B = 0", "sigma_a, B free", "sigma_s', B free", "u, px, B = 0",
                  "valid %"}};
  for (const char* name : {"monte_carlo_angular", "monte_carlo", "dipole"}) {
    const auto model = estimation::make_scattering_model(name, {.eta = kEta, .anisotropy = 0.8});
    if (!model) {
      bench.report.text(std::string(name).append(": ").append(model.error().text()));
      continue;
    }
    const estimation::HarmonicTable harmonics(**model, {}, kRange, 40);
    for (const estimation::truth::TiltedMedium& phantom : *phantoms) {
      const double pitch_mm = kPitchMm / phantom.directions.cos_incidence;
      const PeriodicCurve curve = tilted_curve(phantom, {}, pitch_mm);
      PixelSet pixels = clean_pixels_of(curve, phantom.medium, pitch_mm);
      const Errors fixed =
          fitted_tilted(**model, harmonics, phantom.directions, IndirectLight::kZero, pixels);
      const Errors free =
          fitted_tilted(**model, harmonics, phantom.directions, IndirectLight::kFree, pixels);
      const auto degrees = [](double cosine) {
        return digits(std::acos(std::min(cosine, 1.0)) * 180 / std::numbers::pi);
      };
      const bool is_valid = free.valid_frac > 0.5;
      table.rows.push_back({phantom.name, degrees(phantom.directions.cos_incidence),
                            degrees(phantom.directions.cos_exit), name, percent(fixed.sigma_a.bias),
                            percent(fixed.sigma_s_prime.bias),
                            is_valid ? percent(free.sigma_a.bias) : "-",
                            is_valid ? percent(free.sigma_s_prime.bias) : "-",
                            digits(fixed.u_bias_px, 2), percent(free.valid_frac, 0)});
    }
  }
  bench.report.table(table);
}

}  // namespace

void show_monte_carlo_truth(Bench& bench) {
  const auto media = estimation::truth::read_monte_carlo_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv");
  if (!media) {
    bench.report.text(media.error().text());
    return;
  }
  show_flat(bench, *media, models(bench.report));
  show_tilted(bench);
}

}  // namespace bench
