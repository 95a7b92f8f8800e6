// The peer of our likelihood fit: Levenberg-Marquardt by Ceres on every sample of a pixel.
#include <ceres/ceres.h>
#include <ceres/tiny_solver.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "estimation/models/dipole.h"
#include "estimation/radiometry/noise.h"
#include "tests/bench/methods.h"
#include "tests/bench/two_frequency.h"

namespace bench {
namespace {

using std::numbers::pi;

constexpr int kParameters = 4;  // a: s = sqrt(3) / (1 + exp(-a)); ln l_d; B; u
constexpr int kGreatestHarmonic = 40;
constexpr double kSmallestAmplitude = 1e-6;
const double kLargestS = std::sqrt(3.0);

// The residuals of one pixel over their standard deviations, and their derivatives.
class Residuals {
 public:
  static constexpr int NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = kParameters;
  using Scalar = double;

  Residuals(estimation::StripeShape shape, const std::vector<int>& shifts_px, double boundary,
            const float* samples, double full_signal,
            std::span<const estimation::MergedNoise> noise)
      : shape_(shape),
        shifts_px_(shifts_px),
        boundary_(boundary),
        samples_(samples),
        full_signal_(full_signal) {
    choose_weights(noise);
  }

  int NumResiduals() const { return static_cast<int>(shifts_px_.size()); }

  // Jacobian by columns, as TinySolver has it; may be null.
  bool operator()(const double* parameters, double* residuals, double* jacobian) const {
    return evaluate(parameters, residuals, jacobian, 1, shifts_px_.size());
  }

  // Element (i, p) of the Jacobian at i * row_step + p * col_step.
  bool evaluate(const double* parameters, double* residuals, double* jacobian, std::size_t row_step,
                std::size_t col_step) const {
    const double duty = static_cast<double>(shape_.width_px) / shape_.period_px;
    std::array<Term, kGreatestHarmonic + 1> terms;
    const int count = harmonics(parameters, terms);
    for (std::size_t i = 0; i < shifts_px_.size(); ++i) {
      const double angle =
          2 * pi * (parameters[3] - shifts_px_[i] - 0.5 * (shape_.width_px - 1)) / shape_.period_px;
      double value = terms[0].value + duty * parameters[2];
      double by_a = terms[0].by_a, by_log = 0, by_u = 0;
      double cos_before = 1, sin_before = 0;
      const double cos_1 = std::cos(angle), sin_1 = std::sin(angle);
      for (int n = 1; n <= count; ++n) {
        const double cosine = cos_before * cos_1 - sin_before * sin_1;
        const double sine = sin_before * cos_1 + cos_before * sin_1;
        cos_before = cosine;
        sin_before = sine;
        const Term& term = terms[static_cast<std::size_t>(n)];
        value += term.value * cosine;
        by_a += term.by_a * cosine;
        by_log += term.by_log * cosine;
        by_u -= n * term.value * sine;
      }
      const double weight = weights_[i];
      residuals[i] =
          weight > 0 ? (full_signal_ * value - static_cast<double>(samples_[i])) * weight : 0;
      if (jacobian == nullptr) continue;
      const double scale = full_signal_ * weight;
      jacobian[i * row_step] = scale * by_a;
      jacobian[i * row_step + col_step] = scale * by_log;
      jacobian[i * row_step + 2 * col_step] = scale * duty;
      jacobian[i * row_step + 3 * col_step] = scale * by_u * 2 * pi / shape_.period_px;
    }
    return true;
  }

  // Mean, and amplitude and phase of the first harmonic, of the reflectance factors.
  double mean() const { return mean_; }
  double amplitude() const { return amplitude_; }

 private:
  struct Term {
    double value = 0, by_a = 0, by_log = 0;
  };

  // 2 w/P sinc(n w/P) R~_n and derivatives (n = 0: w/P R_d); how many of them count.
  int harmonics(const double* parameters, std::array<Term, kGreatestHarmonic + 1>& terms) const {
    const double duty = static_cast<double>(shape_.width_px) / shape_.period_px;
    const double share = 1 / (1 + std::exp(-parameters[0]));
    const double s = kLargestS * share, s_by_a = s * (1 - share);
    const double albedo = 1 - s * s / 3, albedo_by_s = -2 * s / 3;
    const double reach = 4.0 / 3.0 * boundary_;
    const double l_d_px = std::exp(parameters[1]);
    for (int n = 0; n <= kGreatestHarmonic; ++n) {
      const double stripe = n == 0 ? duty : 2 * std::sin(pi * n * duty) / (pi * n);
      const double x = 2 * pi * n / shape_.period_px * l_d_px;
      const double root = std::sqrt(1 + x * x), q = s * root;
      const double real = std::exp(-q), image = std::exp(-reach * q);
      const double pair = 0.5 * (1 + image) * real;
      const double pair_by_q = -0.5 * (1 + image * (1 + reach)) * real;
      terms[static_cast<std::size_t>(n)] = {
          .value = stripe * albedo * pair,
          .by_a = stripe * (albedo_by_s * pair + albedo * pair_by_q * root) * s_by_a,
          .by_log = stripe * albedo * pair_by_q * s * x * x / root};
      if (n > 0 && albedo * pair < kSmallestAmplitude) return n;
    }
    return kGreatestHarmonic;
  }

  // 1 / sd of each sample from the sum of its first six harmonics: never from the sample itself.
  void choose_weights(std::span<const estimation::MergedNoise> noise) {
    const auto count = static_cast<double>(shifts_px_.size());
    const int harmonic_count = std::min(6, (static_cast<int>(count) - 1) / 2);
    std::array<double, 7> re{}, im{};
    for (std::size_t i = 0; i < shifts_px_.size(); ++i)
      for (int n = 0; n <= harmonic_count; ++n) {
        const double angle = 2 * pi * n * shifts_px_[i] / shape_.period_px;
        const double share = static_cast<double>(samples_[i]) / count;
        re[static_cast<std::size_t>(n)] += share * std::cos(angle);
        im[static_cast<std::size_t>(n)] += share * std::sin(angle);
      }
    mean_ = re[0] / full_signal_;
    amplitude_ = std::hypot(re[1], im[1]) / full_signal_;
    for (const int shift : shifts_px_) {
      double smooth = re[0];
      for (int n = 1; n <= harmonic_count; ++n) {
        const double angle = 2 * pi * n * shift / shape_.period_px;
        smooth += 2 * (re[static_cast<std::size_t>(n)] * std::cos(angle) +
                       im[static_cast<std::size_t>(n)] * std::sin(angle));
      }
      weights_.push_back(1 / std::sqrt(variance_at(noise, smooth)));
    }
  }

  estimation::StripeShape shape_;
  const std::vector<int>& shifts_px_;
  double boundary_;
  const float* samples_;
  double full_signal_;
  double mean_ = 0, amplitude_ = 0;
  std::vector<double> weights_;
};

class CeresCost : public ceres::CostFunction {
 public:
  explicit CeresCost(const Residuals& residuals) : residuals_(residuals) {
    set_num_residuals(residuals.NumResiduals());
    mutable_parameter_block_sizes()->push_back(kParameters);
  }
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    return residuals_.evaluate(parameters[0], residuals,
                               jacobians == nullptr ? nullptr : jacobians[0], kParameters, 1);
  }

 private:
  const Residuals& residuals_;
};

class CeresFit : public Method {
 public:
  CeresFit(double eta, const PixelSet& pixels, CeresSolver solver)
      : dipole_(eta),
        boundary_(estimation::boundary_factor(eta)),
        start_(dipole_, pixels.shape),
        solver_(solver) {}
  std::string name() const override {
    return solver_ == CeresSolver::kTiny ? "LM on samples (Ceres TinySolver)"
                                         : "LM on samples (Ceres Solver)";
  }

  void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const override {
    estimates.resize(pixels.count);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels.count, 16), [&](const auto& range) {
      for (std::size_t pixel = range.begin(); pixel < range.end(); ++pixel)
        estimates[pixel] = fit(pixels, pixel);
    });
  }

 private:
  Estimate fit(const PixelSet& pixels, std::size_t pixel) const {
    const float* samples = pixels.samples_by_pixel.data() + pixel * pixels.shifts_px.size();
    for (std::size_t i = 0; i < pixels.shifts_px.size(); ++i)
      if (!std::isfinite(samples[i])) return {};
    const Residuals residuals(pixels.shape, pixels.shifts_px, boundary_, samples,
                              static_cast<double>(pixels.full_signal[pixel]), pixels.noise);
    const auto start = start_.find(residuals.mean(), residuals.amplitude());
    const double share =
        dipole_.s_at(std::clamp(start.diffuse_reflectance, 0.001, 0.999)) / kLargestS;
    Eigen::Vector4d parameters(std::log(share / (1 - share)),
                               start.is_inside ? start.log_translucency_px : std::log(4.0), 0,
                               static_cast<double>(pixels.position_px[pixel]));
    const bool has_converged = solver_ == CeresSolver::kTiny ? solve_tiny(residuals, parameters)
                                                             : solve_general(residuals, parameters);
    return {
        .diffuse_reflectance = dipole_.reflectance_at(kLargestS / (1 + std::exp(-parameters[0]))),
        .translucency_px = std::exp(parameters[1]),
        .indirect = parameters[2],
        .is_valid = has_converged && parameters.allFinite()};
  }

  static bool solve_tiny(const Residuals& residuals, Eigen::Vector4d& parameters) {
    ceres::TinySolver<Residuals> solver;
    solver.options.max_num_iterations = 50;
    solver.Solve(residuals, &parameters);
    return solver.summary.status != ceres::TinySolver<Residuals>::HIT_MAX_ITERATIONS;
  }

  static bool solve_general(const Residuals& residuals, Eigen::Vector4d& parameters) {
    CeresCost cost(residuals);
    ceres::Problem::Options ownership;
    ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(ownership);
    problem.AddResidualBlock(&cost, nullptr, parameters.data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.max_num_iterations = 50;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.termination_type == ceres::CONVERGENCE;
  }

  estimation::Dipole dipole_;
  double boundary_;
  TwoFrequencyTable start_;
  CeresSolver solver_;
};

}  // namespace

std::unique_ptr<Method> ceres_fit(double eta, const PixelSet& for_pixels, CeresSolver solver) {
  return std::make_unique<CeresFit>(eta, for_pixels, solver);
}

}  // namespace bench
