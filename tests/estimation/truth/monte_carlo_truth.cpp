#include "tests/estimation/truth/monte_carlo_truth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>

namespace estimation::truth {
namespace {

using std::numbers::pi;

using Fields = std::vector<std::string>;

Fields split(const std::string& line) {
  Fields fields;
  std::stringstream stream(line);
  for (std::string field; std::getline(stream, field, ',');) fields.push_back(field);
  return fields;
}

// The rows below the header line; comments (#) and empty lines are passed over.
Result<std::vector<Fields>> read_rows(const std::filesystem::path& file, std::size_t columns) {
  std::ifstream stream(file);
  if (!stream)
    return tl::unexpected(InputError{InputFault::kNotFound, file.string(), "", "cannot be opened"});
  std::vector<Fields> rows;
  bool is_header = true;
  int number = 0;
  for (std::string line; std::getline(stream, line);) {
    ++number;
    if (line.empty() || line.front() == '#') continue;
    if (std::exchange(is_header, false)) continue;
    rows.push_back(split(line));
    if (rows.back().size() != columns)
      return tl::unexpected(InputError{InputFault::kInvalid, file.string(),
                                       "line " + std::to_string(number),
                                       "expected " + std::to_string(columns) + " columns"});
  }
  return rows;
}

// The cubic through four neighbours of `place` in `values`, of spacing 1.
template <typename T>
T cubic(const std::vector<T>& values, double place) {
  const auto last = static_cast<double>(values.size()) - 4;
  const double first = std::clamp(std::floor(place) - 1, 0.0, last);
  const double x = place - first;
  const T* v = values.data() + static_cast<std::size_t>(first);
  return v[0] * (-(x - 1) * (x - 2) * (x - 3) / 6) + v[1] * (x * (x - 2) * (x - 3) / 2) +
         v[2] * (-x * (x - 1) * (x - 3) / 2) + v[3] * (x * (x - 1) * (x - 2) / 6);
}

// Sum of harmonics at x: the mean, then pairs.
PeriodicCurve harmonic_sum(StripeShape shape, double mean,
                           const std::vector<std::complex<double>>& harmonics) {
  return {shape.period_px, [&](double x_px) {
            const std::complex<double> turn = std::polar(1.0, 2 * pi * x_px / shape.period_px);
            std::complex<double> phasor = 1;
            double sum = mean;
            for (const std::complex<double>& harmonic : harmonics) {
              phasor *= turn;
              sum += 2 * (harmonic * phasor).real();
            }
            return sum;
          }};
}

// [n - 1] w/P sinc(n w/P), as many as lie below the greatest frequency.
std::vector<double> stripe_harmonics(StripeShape shape, double pitch_mm,
                                     double greatest_freq_per_mm) {
  const int count = static_cast<int>(greatest_freq_per_mm * shape.period_px * pitch_mm);
  std::vector<double> harmonics;
  for (int n = 1; n <= count; ++n)
    harmonics.push_back(std::sin(pi * n * shape.width_px / shape.period_px) / (pi * n));
  return harmonics;
}

}  // namespace

double MonteCarloMedium::at(double freq_per_mm) const {
  const double place = freq_per_mm / freq_step_per_mm;
  const auto last = static_cast<double>(reflectance.size() - 1);
  if (place <= last) return cubic(reflectance, place);
  const double from = std::floor(0.8 * last);
  const double end = reflectance.back();
  const double exponent =
      std::log(end / reflectance[static_cast<std::size_t>(from)]) / std::log(last / from);
  return end * std::pow(place / last, exponent);
}

Result<std::vector<MonteCarloMedium>> read_monte_carlo_truth(const std::filesystem::path& file) {
  const auto rows = read_rows(file, 6);
  if (!rows) return tl::unexpected(rows.error());
  std::vector<MonteCarloMedium> media;
  for (const Fields& row : *rows) {
    if (media.empty() || media.back().name != row[0])
      media.push_back({.name = row[0],
                       .medium = {.sigma_a_per_mm = std::stod(row[1]),
                                  .sigma_s_prime_per_mm = std::stod(row[2])},
                       .photon_count = std::stod(row[3]),
                       .reflectance = {}});
    if (media.back().reflectance.size() == 1) media.back().freq_step_per_mm = std::stod(row[4]);
    media.back().reflectance.push_back(std::stod(row[5]));
  }
  return media;
}

double fresnel_transmission(double eta, double cos_incidence) {
  const double sine = std::sqrt(1 - cos_incidence * cos_incidence) / eta;
  const double cos_inside = std::sqrt(1 - sine * sine);
  const double perpendicular =
      (cos_incidence - eta * cos_inside) / (cos_incidence + eta * cos_inside);
  const double parallel = (cos_inside - eta * cos_incidence) / (cos_inside + eta * cos_incidence);
  return 1 - 0.5 * (perpendicular * perpendicular + parallel * parallel);
}

PeriodicCurve monte_carlo_curve(const MonteCarloMedium& medium, StripeShape shape, double pitch_mm,
                                double transmission, double greatest_freq_per_mm) {
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  std::vector<std::complex<double>> harmonics;
  double n = 0;
  for (const double stripe : stripe_harmonics(shape, pitch_mm, greatest_freq_per_mm)) {
    n += 1;
    harmonics.emplace_back(transmission * stripe * medium.at(n / (shape.period_px * pitch_mm)));
  }
  return harmonic_sum(shape, transmission * duty * medium.at(0), harmonics);
}

std::complex<double> TiltedMedium::at(double freq) const {
  const double last = freq_per_mm.back();
  if (freq > last) {
    // The slope over the last fifth; the phase stays.
    const auto from = static_cast<std::size_t>(0.8 * static_cast<double>(freq_per_mm.size() - 1));
    const double exponent = std::log(std::abs(reflectance.back()) / std::abs(reflectance[from])) /
                            std::log(last / freq_per_mm[from]);
    return reflectance.back() * std::pow(freq / last, exponent);
  }
  // Evenly spaced frequencies, as the file has them.
  return cubic(reflectance, freq / freq_per_mm[1]);
}

Result<std::vector<TiltedMedium>> read_tilted_truth(const std::filesystem::path& file) {
  const auto rows = read_rows(file, 12);
  if (!rows) return tl::unexpected(rows.error());
  std::vector<TiltedMedium> media;
  Fields previous;
  for (const Fields& row : *rows) {
    // A curve of its own for each medium and pair of directions: columns 0 to 6.
    if (previous.empty() || !std::equal(row.begin(), row.begin() + 7, previous.begin()))
      media.push_back({.name = row[0],
                       .medium = {.sigma_a_per_mm = std::stod(row[1]),
                                  .sigma_s_prime_per_mm = std::stod(row[2])},
                       .directions = {.cos_incidence = std::stod(row[3]),
                                      .cos_exit = std::stod(row[5]),
                                      .incidence_azimuth_rad = std::stod(row[4]),
                                      .exit_azimuth_rad = std::stod(row[6])},
                       .freq_per_mm = {},
                       .reflectance = {},
                       .standard_error = {}});
    previous = row;
    media.back().freq_per_mm.push_back(std::stod(row[8]));
    media.back().reflectance.emplace_back(std::stod(row[9]), std::stod(row[10]));
    media.back().standard_error.push_back(std::stod(row[11]));
  }
  return media;
}

PeriodicCurve tilted_curve(const TiltedMedium& medium, StripeShape shape, double pitch_mm,
                           double greatest_freq_per_mm) {
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  std::vector<std::complex<double>> harmonics;
  double n = 0;
  for (const double stripe : stripe_harmonics(shape, pitch_mm, greatest_freq_per_mm)) {
    n += 1;
    harmonics.push_back(stripe * medium.at(n / (shape.period_px * pitch_mm)));
  }
  return harmonic_sum(shape, duty * medium.at(0).real(), harmonics);
}

}  // namespace estimation::truth
