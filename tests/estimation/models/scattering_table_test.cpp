// How a white run becomes a table, and that the shipped tables are such tables.
#include "estimation/models/monte_carlo/scattering_table.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <thread>
#include <vector>

#include "estimation/models/monte_carlo/row_smoothing.h"
#include "estimation/models/monte_carlo/shipped_tables.h"
#include "estimation/models/monte_carlo/uniform_spline.h"
#include "estimation/models/monte_carlo/white_table.h"
#include "estimation/models/monte_carlo/white_transform.h"

namespace estimation {
namespace {

std::vector<WhiteScore> run(const WalkMedium& medium, int batch_count, int photons_each) {
  const PhotonWalk walk(medium, {ScoreGrid::kLongestPath_tmfp, 4});
  std::vector<WhiteScore> batches(static_cast<std::size_t>(batch_count));
  for (std::size_t i = 0; i < batches.size(); ++i) batches[i].run(walk, 77, i, photons_each);
  return batches;
}

ScatteringTable shipped(std::string_view file_name) {
  for (const ShippedTable& table : shipped_tables())
    if (table.file_name == file_name)
      return scattering_table_from_text(table.text, std::string(file_name)).value();
  ADD_FAILURE() << "no table " << file_name;
  return {};
}

TEST(WhiteTransform, AllLightLeavesAsAbsorptionGoesToZero) {
  const WalkMedium medium{1.4, 0.8};
  WhiteScore all;
  for (const WhiteScore& batch : run(medium, 4, 2'000)) all.add(batch);
  const WhiteTransform white(medium, all);
  EXPECT_NEAR(white.transform(0, 0), 1, 1e-12);
  double before = 1;
  for (double x = 1e-12; x < 100; x *= 10) {
    const double now = white.transform(x, 0);
    EXPECT_LT(now, before);
    if (x < 1e-9) {
      EXPECT_NEAR((1 - now) / (white.slope() * std::sqrt(3 * x)), 1, 1e-3);
    }
    before = now;
  }
}

TEST(WhiteTransform, PathBinsCostNothing) {
  // The same photons, each with its own path length and exact Bessel functions.
  const WalkMedium medium{1.4, 0.8};
  const PhotonWalk walk(medium, {ScoreGrid::kLongestPath_tmfp, 4});
  constexpr int kPhotons = 3'000;
  WhiteScore score;
  score.run(walk, 5, 9, kPhotons);
  const WhiteTransform white(medium, score);
  RandomStream random(5, 9);
  std::vector<PhotonExit> exits;
  for (int i = 0; i < kPhotons; ++i)
    walk.launch(Direction3{}, random, [&](const PhotonExit& exit) {
      if (exit.scatter_count > 1) exits.push_back(exit);
    });
  for (const double x : {0.3, 3.0, 30.0}) {
    for (const int frequency : {0, 10, 25, 35}) {
      double direct = 0;
      for (const PhotonExit& exit : exits)
        direct += exit.weight * std::exp(-x * exit.path_tmfp) / kPhotons *
                  std::cyl_bessel_j(
                      0.0, ScoreGrid::k_tmfp(frequency) * std::hypot(exit.x_tmfp, exit.y_tmfp));
      // So few photons do not spread evenly over a bin, which counts where x times its width does.
      EXPECT_NEAR(white.multiple(x, frequency), direct,
                  (x < 10 ? 3e-5 : 5e-4) * white.multiple(x, 0))
          << "x " << x << " k " << ScoreGrid::k_tmfp(frequency);
    }
  }
}

TEST(WhiteScore, BatchesDoNotDependOnWhoRanThem) {
  const PhotonWalk walk({1.4, 0.8}, {ScoreGrid::kLongestPath_tmfp, 4});
  std::vector<WhiteScore> one(4), many(4);
  for (std::size_t i = 0; i < 4; ++i) one[i].run(walk, 5, i, 200);
  {
    std::vector<std::jthread> threads;
    for (std::size_t i = 4; i-- > 0;)
      threads.emplace_back([&, i] { many[i].run(walk, 5, i, 200); });
  }
  for (std::size_t i = 0; i < 4; ++i)
    for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin)
      for (const int frequency : {0, 20, 40})
        EXPECT_EQ(one[i].sum(bin, frequency), many[i].sum(bin, frequency));
}

TEST(ScatteringTable, RegenerationAgreesWithTheShippedFile) {
  struct Case {
    WalkMedium medium;
    std::string_view file_name;
  };
  for (const Case& c : {Case{{1.4, 0.8}, "eta1.4_g0.8.txt"}, Case{{1.4, 0}, "eta1.4_g0.txt"}}) {
    SCOPED_TRACE(std::string(c.file_name));
    const ScatteringTable large = shipped(c.file_name);
    const ScatteringTable small = make_scattering_table(c.medium, run(c.medium, 32, 5'000));
    ASSERT_EQ(small.log_transform.size(), large.log_transform.size());
    double squares = 0, worst = 0;
    int count = 0;
    // Up to x = 10: of higher absorption, which only the shortest paths survive, so few photons
    // know nothing, and not how little they know.
    for (int i = 0; absorption_at(large.grid.node(i)) < 10; i += 4) {
      for (int j = 0; j < large.grid.node_count; j += 4) {
        const std::size_t at = large.at(i, j);
        const double error = std::hypot(small.log_transform_se[at], large.log_transform_se[at]);
        if (error < 1e-5) continue;  // below the file's digits: what scatters once is exact
        const double pull = (small.log_transform[at] - large.log_transform[at]) / error;
        squares += pull * pull;
        worst = std::max(worst, std::abs(pull));
        ++count;
      }
    }
    EXPECT_LT(worst, 4.5);
    EXPECT_LT(std::sqrt(squares / count), 2);  // nodes are correlated: few are independent
    EXPECT_GT(count, 200);
    for (std::size_t i = 0; absorption_at(large.grid.node(static_cast<int>(i))) < 10; i += 4)
      EXPECT_NEAR(small.exit_radiance[i][0], large.exit_radiance[i][0],
                  4.5 * small.exit_radiance_se[i])
          << i;
  }
}

TEST(ScatteringTable, ShippedTablesMeetTheirPrecision) {
  ASSERT_EQ(shipped_tables().size(), 5u);
  for (const ShippedTable& file : shipped_tables()) {
    SCOPED_TRACE(std::string(file.file_name));
    const auto table = scattering_table_from_text(file.text, std::string(file.file_name));
    ASSERT_TRUE(table) << table.error().text();
    EXPECT_LT(file.text.size(), 110'000u);
    double worst_bright = 0, worst_dim = 0;
    for (std::size_t i = 0; i < table->log_transform.size(); ++i) {
      const double transform = std::exp(table->log_transform[i]);
      double& worst = transform > 0.1 ? worst_bright : worst_dim;
      if (transform > 0.01) worst = std::max(worst, table->log_transform_se[i]);
    }
    std::printf(
        "%s: %lld photons, energy residual %.1e +- %.0e, largest standard error %.2f%% "
        "where R~ > 0.1, %.2f%% where > 0.01\n",
        std::string(file.file_name).c_str(), static_cast<long long>(table->photon_count),
        table->energy_residual, table->energy_residual_se, 100 * worst_bright, 100 * worst_dim);
    EXPECT_LE(worst_bright, 1e-3);
    EXPECT_LE(worst_dim, 1e-2);
    EXPECT_LT(std::abs(table->energy_residual), 4 * table->energy_residual_se);
  }
}

TEST(ScatteringTable, TextReadsBack) {
  const WalkMedium medium{1.33, 0.75};
  ScatteringTable table = make_scattering_table(medium, run(medium, 2, 300));
  table.program = "a program 2";
  table.seed = 12345678901234567890u;
  const auto back = scattering_table_from_text(to_text(table), "x");
  ASSERT_TRUE(back) << back.error().text();
  EXPECT_EQ(back->eta, table.eta);
  EXPECT_EQ(back->anisotropy, table.anisotropy);
  EXPECT_EQ(back->program, table.program);
  EXPECT_EQ(back->photon_count, table.photon_count);
  EXPECT_EQ(back->seed, table.seed);
  EXPECT_EQ(back->grid.node_count, table.grid.node_count);
  EXPECT_EQ(back->grid.step, table.grid.step);
  for (std::size_t i = 0; i < table.log_transform.size(); ++i) {
    EXPECT_NEAR(back->log_transform[i], table.log_transform[i], 0.51e-6);
    EXPECT_GE(back->log_transform_se[i], table.log_transform_se[i] * (1 - 1e-9));
  }
}

TEST(ScatteringTable, BrokenTextIsRefusedWithItsLine) {
  const std::string good(shipped_tables().front().text);
  const auto error_of = [](const std::string& text) {
    const auto table = scattering_table_from_text(text, "t.txt");
    return table ? std::string("read") : table.error().text();
  };
  EXPECT_EQ(error_of(""), "t.txt: line 1: expected 'ssrig'");
  EXPECT_EQ(error_of(good), "read");
  std::string broken = good;
  broken.replace(broken.find("\neta ") + 5, 1, "x");
  EXPECT_EQ(error_of(broken), "t.txt: line 3: expected a number");
  EXPECT_NE(error_of(good.substr(0, good.size() / 2)), "read");
  broken = good;
  broken.replace(broken.find("grid_nodes ") + 11, 2, "-9");
  EXPECT_EQ(error_of(broken), "t.txt: line 11: the medium or the grid is out of range");
}

TEST(UniformSpline, GoesThroughItsNodesEvenAtOneEndStraightBeyondTheOther) {
  std::vector<double> values(12);
  for (std::size_t i = 0; i < 12; ++i) values[i] = std::cos(0.3 * static_cast<double>(i));
  for (const SplineStart start : {SplineStart::kEven, SplineStart::kNatural}) {
    const std::vector<double> c = spline_coefficients(values, start);
    const auto at = [&](double place) { return SplinePlace(place, values.size()).sum(c.data()); };
    for (int i = 0; i < 12; ++i) EXPECT_NEAR(at(i), values[static_cast<std::size_t>(i)], 1e-14);
    const double slope = (at(0.001) - at(0)) / 0.001, bend = at(0) - 2 * at(0.01) + at(0.02);
    if (start == SplineStart::kEven) {
      EXPECT_NEAR(slope, 0, 1e-4);
    } else {
      EXPECT_NEAR(bend, 0, 1e-5);
    }
    EXPECT_NEAR(at(13) - at(12), at(12) - at(11), 1e-13);
    EXPECT_NEAR(at(1e6) / (1e6 - 11), at(12) - at(11), 1e-5);
    EXPECT_NEAR((at(11) - at(11 - 1e-6)) / 1e-6, at(12) - at(11), 1e-6);
  }
  const std::vector<double> c = spline_coefficients(values, SplineStart::kEven);
  EXPECT_NEAR(SplinePlace(2.5, values.size()).sum(c.data()), std::cos(0.75), 5e-5);
}

TEST(RowSmoothing, KeepsParabolasAndHalvesNoise) {
  std::vector<double> parabola, noisy;
  RandomStream random(3, 3);
  for (int i = 0; i < 50; ++i) {
    parabola.push_back(0.3 - 0.02 * i + 0.001 * i * i);
    noisy.push_back(parabola.back() + 0.02 * (random.uniform() - 0.5));
  }
  const std::vector<double> errors(50, 0.02 / std::sqrt(12));
  const RowSmoothing smoothing(errors, 1e-3);
  const std::vector<double> kept = smoothing.smooth(parabola), smooth = smoothing.smooth(noisy);
  double before = 0, after = 0;
  for (std::size_t i = 0; i < 50; ++i) {
    EXPECT_NEAR(kept[i], parabola[i], 1e-9);
    before += std::pow(noisy[i] - parabola[i], 2);
    after += std::pow(smooth[i] - parabola[i], 2);
  }
  EXPECT_LT(std::sqrt(after), 0.6 * std::sqrt(before));
  // Without noise a row of any shape stays as it is.
  const std::vector<double> same = RowSmoothing(std::vector<double>(50, 1e-9), 1e-3).smooth(noisy);
  for (std::size_t i = 0; i < 50; ++i) EXPECT_NEAR(same[i], noisy[i], 1e-6);
}

}  // namespace
}  // namespace estimation
