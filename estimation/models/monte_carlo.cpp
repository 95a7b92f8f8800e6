#include "estimation/models/monte_carlo.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "estimation/base/check.h"
#include "estimation/models/monte_carlo/photon_walk.h"
#include "estimation/models/monte_carlo/shipped_tables.h"
#include "estimation/models/monte_carlo/uniform_spline.h"

namespace estimation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kMostNodes = 256;

std::string medium_text(double eta, double anisotropy) {
  char text[64];
  std::snprintf(text, sizeof text, "eta %g with g %g", eta, anisotropy);
  return text;
}

}  // namespace

MonteCarlo::MonteCarlo(const ScatteringTable& table)
    : eta_(table.eta),
      grid_(table.grid),
      slope_(table.slope),
      row_size_(static_cast<std::size_t>(grid_.node_count) + 2),
      standard_error_(table.log_transform_se) {
  const auto count = static_cast<std::size_t>(grid_.node_count);
  check(count <= kMostNodes && table.log_transform.size() == count * count &&
            standard_error_.size() == count * count && table.exit_radiance.size() == count,
        "a scattering table has all its nodes");
  // First along k, then along s.
  std::vector<double> along_k;
  for (int i = 0; i < grid_.node_count; ++i) {
    std::vector<double> row;
    row.reserve(count);
    for (int j = 0; j < grid_.node_count; ++j)
      row.push_back(table.log_transform[table.at(i, j)] +
                    std::log1p(slope_ * std::hypot(grid_.node(i), grid_.node(j))));
    const std::vector<double> c = spline_coefficients(row, SplineStart::kEven);
    along_k.insert(along_k.end(), c.begin(), c.end());
  }
  coefficients_.resize(row_size_ * row_size_);
  for (std::size_t j = 0; j < row_size_; ++j) {
    std::vector<double> column;
    for (std::size_t i = 0; i < count; ++i) column.push_back(along_k[i * row_size_ + j]);
    const std::vector<double> c = spline_coefficients(column, SplineStart::kEven);
    for (std::size_t i = 0; i < row_size_; ++i) coefficients_[i * row_size_ + j] = c[i];
  }
  for (std::size_t i = 0; i < row_size_; ++i) {
    const double* row = &coefficients_[i * row_size_];
    reflectance_.push_back((row[0] + 4 * row[1] + row[2]) / 6);
  }
  for (int i = 0; i < grid_.node_count; ++i) attenuation_.push_back(attenuation(grid_.node(i)));
  for (std::size_t power = 0; power < exit_radiance_.size(); ++power) {
    std::vector<double> column;
    for (const ExitRadiance& radiance : table.exit_radiance) column.push_back(radiance[power]);
    exit_radiance_[power] = spline_coefficients(column, SplineStart::kNatural);
  }
}

double MonteCarlo::attenuation(double s) const {
  const SplinePlace place(grid_.place(s), row_size_ - 2);
  return std::log1p(slope_ * s) - place.sum(reflectance_.data());
}

double MonteCarlo::reflectance_at(double s) const { return std::exp(-attenuation(s)); }

// Between the nodes around it as if -ln R_d were straight there.
double MonteCarlo::first_guess(double attenuation) const {
  if (attenuation < attenuation_[1]) return std::expm1(attenuation) / slope_;
  const auto above = std::upper_bound(attenuation_.begin(), attenuation_.end() - 1, attenuation);
  const double before = *(above - 1);
  const auto index = static_cast<double>(above - attenuation_.begin() - 1);
  // Beyond the last node R_d falls like 1/s.
  if (attenuation > *above)
    return grid_.node(grid_.node_count - 1) * std::exp(attenuation - *above);
  const double place = index + (attenuation - before) / (*above - before);
  return grid_.scale * std::sinh(grid_.step * place);
}

double MonteCarlo::s_at(double diffuse_reflectance) const {
  if (!(diffuse_reflectance >= 0 && diffuse_reflectance <= 1)) return kNan;
  if (diffuse_reflectance == 1) return 0;
  if (diffuse_reflectance == 0) return std::numeric_limits<double>::infinity();
  // R_d - 1 is exact.
  const double target = diffuse_reflectance > 0.5 ? -std::log1p(diffuse_reflectance - 1)
                                                  : -std::log(diffuse_reflectance);
  // Newton in ln s on ln(-ln R_d), which is nearly straight at both ends, inside a bracket that
  // every step shrinks; a step that leaves it becomes a bisection.
  double low = -745, high = 745;  // of ln s: all that a double holds
  double s = first_guess(target);
  for (int step = 0; step < 100; ++step) {
    const double value = attenuation(s);
    const double ln_s = std::log(s);
    (value < target ? low : high) = ln_s;
    constexpr double kNudge = 1e-6;
    const double slope = std::log(attenuation(s * (1 + kNudge)) / value) / kNudge;
    double next = ln_s - std::log(value / target) / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    s *= std::exp(next - ln_s);
    // The slope has six digits, so each step gains at least as many.
    if (std::abs(next - ln_s) < 1e-9) break;
  }
  return s;
}

void MonteCarlo::transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                           std::span<double> out) const {
  check(k_times_l_d.size() == out.size(), "one value of R~ for each frequency");
  const double s = s_at(diffuse_reflectance);
  if (!std::isfinite(s)) {
    std::fill(out.begin(), out.end(), diffuse_reflectance == 0 ? 0 : kNan);
    return;
  }
  // The spline along k at this s, for all frequencies.
  const SplinePlace place(grid_.place(s), row_size_ - 2);
  std::array<double, kMostNodes + 2> row;
  const double* c = &coefficients_[place.first * row_size_];
  for (std::size_t j = 0; j < row_size_; ++j)
    row[j] = place.weight[0] * c[j] + place.weight[1] * c[row_size_ + j] +
             place.weight[2] * c[2 * row_size_ + j] + place.weight[3] * c[3 * row_size_ + j];
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double x = k_times_l_d[i];
    if (!(x >= 0)) {
      out[i] = kNan;
      continue;
    }
    const SplinePlace along_k(grid_.place(s * x), row_size_ - 2);
    out[i] = std::exp(along_k.sum(row.data())) / (1 + slope_ * s * std::sqrt(1 + x * x));
  }
}

double MonteCarlo::transform_at(double s, double k_tmfp) const {
  const SplinePlace along_s(grid_.place(s), row_size_ - 2);
  const SplinePlace along_k(grid_.place(k_tmfp), row_size_ - 2);
  double sum = 0;
  for (std::size_t i = 0; i < 4; ++i)
    sum += along_s.weight[i] * along_k.sum(&coefficients_[(along_s.first + i) * row_size_]);
  return std::exp(sum) / (1 + slope_ * std::hypot(s, k_tmfp));
}

double MonteCarlo::relative_standard_error(double s, double k_tmfp) const {
  const auto count = static_cast<std::size_t>(grid_.node_count);
  const auto cell = [&](double value, double& t) {
    const double place = std::min(grid_.place(value), static_cast<double>(count - 1));
    const auto index = std::min(static_cast<std::size_t>(place), count - 2);
    t = place - static_cast<double>(index);
    return index;
  };
  double t, u;
  const std::size_t i = cell(s, t), j = cell(k_tmfp, u);
  const double* corner = &standard_error_[i * count + j];
  return (1 - t) * ((1 - u) * corner[0] + u * corner[1]) +
         t * ((1 - u) * corner[count] + u * corner[count + 1]);
}

double MonteCarlo::exit_radiance(double s, double cos_exit) const {
  const double last = static_cast<double>(row_size_ - 3);
  const SplinePlace place(std::min(grid_.place(s), last), row_size_ - 2);
  const double v = 1 - cos_exit * cos_exit;
  double sum = 0;
  for (std::size_t power = exit_radiance_.size(); power-- > 0;)
    sum = sum * v + place.sum(exit_radiance_[power].data());
  return transmitted_frac(eta_, cos_exit) * sum;
}

void MonteCarlo::direction_factors(double diffuse_reflectance, std::span<const double>,
                                   const Directions& directions,
                                   std::span<std::complex<double>> out) const {
  const double factor = transmitted_frac(eta_, directions.cos_incidence) *
                        exit_radiance(s_at(diffuse_reflectance), directions.cos_exit);
  std::fill(out.begin(), out.end(), std::complex<double>(factor, 0));
}

Coefficients MonteCarlo::coefficients(double diffuse_reflectance, double translucency_mm) const {
  const double s = s_at(diffuse_reflectance);
  const double sigma_s_prime = 1 / (translucency_mm * s);
  return {.sigma_a_per_mm = absorption_at(s) * sigma_s_prime,
          .sigma_s_prime_per_mm = sigma_s_prime};
}

Result<std::unique_ptr<ScatteringModel>> make_monte_carlo(const MediumOptions& medium) {
  std::string known;
  for (const ShippedTable& shipped : shipped_tables()) {
    const std::string name(shipped.file_name);
    const Result<ScatteringTable> head = scattering_table_head(shipped.text, name);
    if (!head) return tl::unexpected(head.error());
    if (std::abs(head->eta - medium.eta) < 1e-9 &&
        std::abs(head->anisotropy - medium.anisotropy) < 1e-9) {
      Result<ScatteringTable> table = scattering_table_from_text(shipped.text, name);
      if (!table) return tl::unexpected(table.error());
      return std::make_unique<MonteCarlo>(*table);
    }
    known.append(known.empty() ? "" : ", ").append(medium_text(head->eta, head->anisotropy));
  }
  std::string expectation = "is ";
  expectation.append(medium_text(medium.eta, medium.anisotropy))
      .append("; monte_carlo has tables for: ")
      .append(known);
  return tl::unexpected(InputError{InputFault::kInvalid, "", "medium", expectation});
}

}  // namespace estimation
