// refine-figure FOLDER: error of sigma_a and l_d against the distance from the end of the light and
// from a crease, as fitted and refined (border_error.png, .svg, .csv).
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "tests/bench/figure.h"
#include "tests/estimation/refine/line_truth.h"

namespace {

using namespace estimation;

constexpr int kRounds = 4;  // as refinement.cpp
constexpr double kLeastPercent = 0.01;

struct Curves {
  std::vector<bench::Point> sigma_a, translucency;
};

struct Outcome {
  Curves before, after;
};

Outcome outcome_of(LineScene scene, int first_col, int last_col, double origin_mm, double sign,
                   const char* name, std::ofstream& csv) {
  const Dipole model(1.4);
  const FittedMaps before = fit_columns(scene, model);
  const FittedMaps after = refine_columns(scene, model, kRounds);
  Outcome outcome;
  for (int col = first_col; col <= last_col; ++col) {
    const double distance =
        sign * (scene.x_mm(col) - origin_mm) / diffuse_mean_free_path_mm(kCheekRed);
    const RelativeError b = error_at(before, col, model, kCheekRed);
    const RelativeError a = error_at(after, col, model, kCheekRed);
    const auto percent = [](double error) { return std::max(100 * error, kLeastPercent); };
    outcome.before.sigma_a.push_back({distance, percent(b.sigma_a)});
    outcome.before.translucency.push_back({distance, percent(b.translucency)});
    outcome.after.sigma_a.push_back({distance, percent(a.sigma_a)});
    outcome.after.translucency.push_back({distance, percent(a.translucency)});
    csv << name << ',' << distance << ',' << b.reflectance << ',' << b.translucency << ','
        << b.sigma_a << ',' << b.sigma_s_prime << ',' << a.reflectance << ',' << a.translucency
        << ',' << a.sigma_a << ',' << a.sigma_s_prime << '\n';
  }
  return outcome;
}

bench::Figure figure_of(const Outcome& outcome, const char* title, const char* x_label) {
  const auto series = [](const char* name, bench::Color color, bench::MarkShape shape,
                         const std::vector<bench::Point>& points) {
    return bench::Series{
        .name = name, .color = color, .shape = shape, .points = points, .is_joined = true};
  };
  return {.title = title,
          .x = {.label = x_label},
          .y = {.label = "error, %", .is_log = true, .low = kLeastPercent, .high = 1000},
          .series = {series("sigma_a, as fitted", bench::kPalette[1], bench::MarkShape::kDisc,
                            outcome.before.sigma_a),
                     series("l_d, as fitted", bench::kPalette[4], bench::MarkShape::kSquare,
                            outcome.before.translucency),
                     series("sigma_a, refined", bench::kPalette[0], bench::MarkShape::kDisc,
                            outcome.after.sigma_a),
                     series("l_d, refined", bench::kPalette[5], bench::MarkShape::kSquare,
                            outcome.after.translucency)}};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: refine-figure FOLDER\n");
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  std::filesystem::create_directories(folder);
  const truth::DipoleLineSpread spread(kCheekRed, 1.4);
  std::ofstream csv(folder / "border_error.csv");
  csv << "scene,distance_l_d,R_d_before,l_d_before,sigma_a_before,sigma_s_prime_before,R_d_after,"
         "l_d_after,sigma_a_after,sigma_s_prime_after\n";
  const LineScene light = half_plane_of_light(spread);
  const Outcome end = outcome_of(light, 32, 60, light.edge_mm, -1, "end of the light", csv);
  const Outcome bend = outcome_of(crease(spread), 46, 98, 0, 1, "crease", csv);
  const bench::Scene picture = bench::draw(
      {figure_of(end, "Beside the end of the light", "distance from it, l_d"),
       figure_of(bend, "In a crease of 120 degrees", "distance across it, l_d (tilted: right)")});
  std::ofstream(folder / "border_error.svg") << bench::svg(picture);
  const std::vector<unsigned char> png = bench::png(picture);
  std::ofstream(folder / "border_error.png", std::ios::binary)
      .write(reinterpret_cast<const char*>(png.data()), static_cast<std::streamsize>(png.size()));
  return csv ? 0 : 1;
}
