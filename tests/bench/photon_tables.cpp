#include "tests/bench/photon_tables.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

namespace bench {

namespace {

constexpr std::size_t kShifts = 40;  // the paper's plan begins with them
constexpr int kRimPx = 2;            // of a window: the estimator lacks neighbours there

// Bins of distance in the pixel's own l_d.
struct Bin {
  const char* name;
  double from, to;
};
constexpr Bin kBins[] = {{"0 (materials mix)", -1, 1e-9},
                         {"0 to 0.5", 1e-9, 0.5},
                         {"0.5 to 1", 0.5, 1},
                         {"1 to 2", 1, 2},
                         {"2 to 4", 2, 4},
                         {"above 4", 4, 1e9}};
constexpr const char* kBands[] = {"red", "green", "blue"};

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto at = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

std::vector<double> magnitudes(std::vector<double> values) {
  for (double& value : values) value = std::abs(value);
  return values;
}

bool is_counted(const Window& window, const WindowPixel& pixel) {
  return pixel.is_lit && pixel.cos_projector > 0.2 && pixel.row >= kRimPx && pixel.col >= kRimPx &&
         pixel.row < window.plan.height_px - kRimPx && pixel.col < window.plan.width_px - kRimPx;
}

// In l_d, to a border or a break, whichever is nearer.
double distance_of(const WindowPixel& pixel) {
  return std::min(pixel.border_distance_mm, pixel.break_distance_mm) /
         pixel.scattering.translucency_mm();
}

using Chosen = std::vector<std::size_t>;  // pixels

struct Row {
  std::string part, distance;
  Chosen pixels;
};

std::vector<Row> rows_of(const WindowResult& result) {
  std::vector<Row> rows;
  const auto add = [&](const std::string& part, const std::string& distance,
                       const std::function<bool(const WindowPixel&)>& is_in) {
    Chosen chosen;
    for (std::size_t i = 0; i < result.window.pixels.size(); ++i) {
      const WindowPixel& pixel = result.window.pixels[i];
      if (is_counted(result.window, pixel) && is_in(pixel)) chosen.push_back(i);
    }
    constexpr std::size_t kFewest = 8;
    if (chosen.size() >= kFewest) rows.push_back({part, distance, chosen});
  };
  const bool has_sides = result.window.plan.inside != hw_sim::Region::kNone;
  for (const bool is_inside : {true, false})
    for (const Bin& bin : kBins)
      add(is_inside   ? "inside"
          : has_sides ? "outside"
                      : "all",
          bin.name, [&](const WindowPixel& pixel) {
            const double distance = distance_of(pixel);
            return pixel.is_inside == is_inside && distance >= bin.from && distance < bin.to;
          });
  for (int band = 0; band < 3; ++band)
    add(kBands[band], "all", [&](const WindowPixel& pixel) { return pixel.band == band; });
  return rows;
}

Table profile_table(const WindowResult& result) {
  Table table{.name = std::string("photon_profiles_").append(result.window.plan.name),
              .title = "Stripe profiles: surface less photons, % of the surface's mean",
              .columns = {"part", "distance, l_d", "pixels", "level mean (se)", "level p95",
                          "its noise p95", "profile median", "profile p95", "its noise median",
                          "profile rms without noise"}};
  for (const Row& row : rows_of(result)) {
    std::vector<double> level, level_se, shape, shape_se;
    double squares = 0, mean = 0, mean_variance = 0;
    for (const std::size_t i : row.pixels) {
      const ProfileDifference& d = result.profiles[i];
      level.push_back(d.level);
      mean += d.level / static_cast<double>(row.pixels.size());
      mean_variance += std::pow(d.level_se / static_cast<double>(row.pixels.size()), 2);
      level_se.push_back(1.96 * d.level_se);
      shape.push_back(d.shape);
      shape_se.push_back(d.shape_se);
      squares +=
          (d.shape * d.shape - d.shape_se * d.shape_se) / static_cast<double>(row.pixels.size());
    }
    table.rows.push_back(
        {row.part, row.distance, std::to_string(row.pixels.size()),
         percent(mean).append(" (").append(percent(std::sqrt(mean_variance))).append(")"),
         percent(quantile(magnitudes(level), 0.95)), percent(quantile(level_se, 0.5)),
         percent(quantile(shape, 0.5)), percent(quantile(shape, 0.95)),
         percent(quantile(shape_se, 0.5)), percent(std::sqrt(std::max(squares, 0.0)))});
  }
  return table;
}

using Quantity = double (*)(const Recovered&);
struct Named {
  const char* name;
  Quantity of;
  double (*truth)(const hw_sim::Scattering&);
};
constexpr Named kQuantities[] = {
    {"sigma_a", [](const Recovered& r) { return r.sigma_a_per_mm; },
     [](const hw_sim::Scattering& s) { return s.sigma_a_per_mm; }},
    {"sigma_s'", [](const Recovered& r) { return r.sigma_s_prime_per_mm; },
     [](const hw_sim::Scattering& s) { return s.sigma_s_prime_per_mm; }},
    {"l_d", [](const Recovered& r) { return r.translucency_mm; },
     [](const hw_sim::Scattering& s) { return s.translucency_mm(); }}};

// Of the pixels that all fits made something of.
struct Errors {
  std::vector<double> surface, photons;  // of the truth
  std::vector<double> noise;             // of the photons
};

Errors errors_of(const WindowResult& result, const Chosen& pixels, const Named& quantity) {
  Errors errors;
  for (const std::size_t i : pixels) {
    const Recovered &surface = result.from_surface[i], &photons = result.from_photons[i];
    const Recovered& half = result.from_half[i];
    if (!surface.is_valid || !photons.is_valid || !half.is_valid) continue;
    const double truth = quantity.truth(result.window.pixels[i].scattering);
    errors.surface.push_back(quantity.of(surface) / truth - 1);
    errors.photons.push_back(quantity.of(photons) / truth - 1);
    // Half of the paths differ from all of them by as much as all of them from the truth.
    errors.noise.push_back((quantity.of(half) - quantity.of(photons)) / truth);
  }
  return errors;
}

Table recovered_table(const WindowResult& result) {
  Table table{.name = std::string("photon_recovered_").append(result.window.plan.name),
              .title =
                  "What the estimator recovers: error % against the material where the pixel "
                  "looks; bias is the median, p95 of the magnitude",
              .columns = {"part", "distance, l_d", "fits"}};
  for (const Named& quantity : kQuantities)
    for (const char* column :
         {" by the surface: bias / p95", " by photons: bias (se) / p95 (of noise)"})
      table.columns.push_back(std::string(quantity.name).append(column));
  const auto p95 = [](const std::vector<double>& errors) {
    return percent(quantile(magnitudes(errors), 0.95), 1);
  };
  for (const Row& row : rows_of(result)) {
    table.rows.push_back({row.part, row.distance});
    std::vector<std::string>& cells = table.rows.back();
    for (const Named& quantity : kQuantities) {
      const Errors e = errors_of(result, row.pixels, quantity);
      if (&quantity == &kQuantities[0])
        cells.push_back(
            std::to_string(e.surface.size()).append("/").append(std::to_string(row.pixels.size())));
      cells.push_back(percent(quantile(e.surface, 0.5), 1).append(" / ").append(p95(e.surface)));
      // Of the median of so many normal variables.
      const double se = 1.2533 * quantile(magnitudes(e.noise), 0.5) / 0.6745 /
                        std::sqrt(static_cast<double>(e.noise.size()));
      cells.push_back(percent(quantile(e.photons, 0.5), 1)
                          .append(" (")
                          .append(percent(se, 1))
                          .append(") / ")
                          .append(p95(e.photons))
                          .append(" (")
                          .append(p95(e.noise))
                          .append(")"));
    }
  }
  return table;
}

Table pixel_table(const WindowResult& result) {
  Table table{.name = std::string("photon_window_").append(result.window.plan.name),
              .title = "",
              .columns = {"row",
                          "col",
                          "band",
                          "counted",
                          "inside",
                          "distance_l_d",
                          "border_mm",
                          "break_mm",
                          "level",
                          "level_se",
                          "profile",
                          "profile_se",
                          "sigma_a",
                          "surface_sigma_a",
                          "photons_sigma_a",
                          "sigma_s_prime",
                          "surface_sigma_s_prime",
                          "photons_sigma_s_prime",
                          "l_d_mm",
                          "surface_l_d_mm",
                          "photons_l_d_mm"}};
  for (std::size_t i = 0; i < result.window.pixels.size(); ++i) {
    const WindowPixel& p = result.window.pixels[i];
    const ProfileDifference& d = result.profiles[i];
    std::vector<std::string> row = {std::to_string(p.row), std::to_string(p.col), kBands[p.band],
                                    is_counted(result.window, p) ? "1" : "0",
                                    p.is_inside ? "1" : "0"};
    for (const double value : {distance_of(p), p.border_distance_mm, p.break_distance_mm, d.level,
                               d.level_se, d.shape, d.shape_se})
      row.push_back(digits(value, 5));
    for (const Named& quantity : kQuantities) {
      row.push_back(digits(quantity.truth(p.scattering), 5));
      for (const Recovered& r : {result.from_surface[i], result.from_photons[i]})
        row.push_back(r.is_valid ? digits(quantity.of(r), 5) : "-");
    }
    table.rows.push_back(std::move(row));
  }
  return table;
}

std::vector<ProfileDifference> differences(const Window& window) {
  std::vector<ProfileDifference> all;
  for (std::size_t i = 0; i < window.pixels.size(); ++i) {
    double mean = 0, off = 0, squares = 0, noise = 0;
    for (std::size_t shift = 0; shift < kShifts; ++shift) {
      const double difference = window.surface[shift][i] - window.photons[shift][i];
      mean += window.surface[shift][i] / kShifts;
      off += difference / kShifts;
      squares += difference * difference / kShifts;
      noise += window.photons_se[shift][i] * window.photons_se[shift][i] / kShifts;
    }
    all.push_back({off / mean, window.level_se[i] / mean, std::sqrt(squares) / mean,
                   std::sqrt(noise) / mean});
  }
  return all;
}

}  // namespace

WindowResult judge(Window window, const WindowOptions& options) {
  WindowResult result;
  result.profiles = differences(window);
  result.from_surface = recover(window, window.surface, options.thread_count);
  result.from_photons = recover(window, window.photons, options.thread_count);
  result.from_half = recover(window, window.half, options.thread_count);
  result.window = std::move(window);
  return result;
}

void show_window(Report& report, const WindowResult& result, const std::filesystem::path& folder) {
  const Window& window = result.window;
  report.text(std::string("### Surface against photons: ").append(window.plan.title));
  report.text(std::to_string(window.pixels.size())
                  .append(" pixels, ")
                  .append(digits(static_cast<double>(window.path_count)))
                  .append(" paths in ")
                  .append(digits(window.photon_cpu_s))
                  .append(" s of CPU."));
  report.table(profile_table(result));
  report.table(recovered_table(result));
  report.table(pixel_table(result), false);
  write_picture(report, result, folder);
}

}  // namespace bench
