#include "hw_sim/world/layer_doubling.h"

#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <vector>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

namespace {

using Matrix = cv::Mat_<double>;

// Directions inside: Gauss points on both sides of the critical angle, where the boundary's
// reflectance bends, and the nodes that are asked for, which no integral counts.
struct Streams {
  static constexpr int kGauss = 16;
  std::vector<double> cosines, weights;  // of integrals over the cosine
  std::size_t first_node = 0;
  std::size_t count() const { return cosines.size(); }

  Streams() {
    const double critical = std::sqrt(1 - 1 / (kSkinIndex * kSkinIndex));
    add_gauss(0, critical);
    add_gauss(critical, 1);
    first_node = cosines.size();
    for (const double sine2 : kNodeSines2) {
      cosines.push_back(std::sqrt(1 - sine2 / (kSkinIndex * kSkinIndex)));
      weights.push_back(0);
    }
  }

 private:
  // Newton's method on Legendre's polynomial.
  void add_gauss(double begin, double end) {
    for (int i = 0; i < kGauss; ++i) {
      double x = std::cos(std::numbers::pi * (i + 0.75) / (kGauss + 0.5)), slope = 0;
      for (int step = 0; step < 20; ++step) {
        double now = 1, before = 0;
        for (int l = 0; l < kGauss; ++l) {
          const double next = ((2 * l + 1) * x * now - l * before) / (l + 1);
          before = now;
          now = next;
        }
        slope = kGauss * (x * now - before) / (x * x - 1);
        x -= now / slope;
      }
      cosines.push_back(begin + (end - begin) * (1 + x) / 2);
      weights.push_back((end - begin) / ((1 - x * x) * slope * slope));
    }
  }
};

// Associated Legendre functions of order k times sqrt((l - k)! / (l + k)!), l from k on.
std::vector<double> legendre(int k, double x, int count) {
  double start = 1;
  for (int i = 1; i <= k; ++i) start *= std::sqrt((2 * i - 1) / (2.0 * i) * (1 - x * x));
  std::vector<double> values = {start};
  double before = 0;
  for (int l = k; l + 1 < k + count; ++l) {
    const double next =
        ((2 * l + 1) * x * values.back() - std::sqrt(static_cast<double>(l * l - k * k)) * before) /
        std::sqrt(static_cast<double>((l + 1) * (l + 1) - k * k));
    before = values.back();
    values.push_back(next);
  }
  return values;
}

// The phase function's azimuthal order k between streams that keep, or change, their side.
struct Phase {
  Matrix forward, back;

  Phase(const Streams& streams, int k) {
    constexpr int kTerms = 80;  // g^80 = 2e-8
    const int n = static_cast<int>(streams.count());
    forward = Matrix::zeros(n, n);
    back = Matrix::zeros(n, n);
    std::vector<std::vector<double>> values;
    for (const double cosine : streams.cosines) values.push_back(legendre(k, cosine, kTerms));
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < n; ++j)
        for (std::size_t term = 0; term < kTerms; ++term) {
          const double l = static_cast<double>(term) + k;
          const double part = (2 * l + 1) * std::pow(kSkinAnisotropy, l) *
                              values[static_cast<std::size_t>(i)][term] *
                              values[static_cast<std::size_t>(j)][term];
          forward(i, j) += part;
          back(i, j) += term % 2 == 0 ? part : -part;
        }
  }
};

// A kernel X says: radiance out = 2 integral X(out, in) cos(in) radiance in. Products of kernels
// therefore weigh their inner cosine.
class Doubling {
 public:
  Doubling(const Streams& streams, const Phase& phase, double albedo) : streams_(streams) {
    // An optical depth in which grazing light, too, scatters once at most: 1e-8 puts 1e-5 on R_d.
    constexpr double kThin = 1e-9;
    const int n = static_cast<int>(streams.count());
    reflected_ = Matrix(n, n);
    passed_ = Matrix(n, n);
    weights_ = Matrix(n, 1);
    for (int i = 0; i < n; ++i) {
      const double out = cosine(i);
      weights_(i) = 2 * out * streams.weights[static_cast<std::size_t>(i)];
      direct_.push_back(std::exp(-kThin / out));
      for (int j = 0; j < n; ++j) {
        const double scale = albedo / (4 * out * cosine(j)) * kThin;
        reflected_(i, j) = scale * phase.back(i, j);
        passed_(i, j) = scale * phase.forward(i, j);
      }
    }
    // To a depth of 2200, which next to no light passes at the least absorption that is tabulated.
    constexpr int kDoublings = 41;
    for (int i = 0; i < kDoublings; ++i) twice();
  }

  // With the boundary: what it throws back inside comes again.
  Matrix under_boundary() const {
    Matrix system = weighed(reflected_);
    for (int j = 0; j < system.cols; ++j)
      system.col(j) *= fresnel_reflectance(cosine(j), kSkinIndex, 1);
    return solved(system, reflected_);
  }

 private:
  double cosine(int i) const { return streams_.cosines[static_cast<std::size_t>(i)]; }

  Matrix weighed(const Matrix& kernel) const {
    Matrix columns = kernel.clone();
    for (int j = 0; j < columns.cols; ++j) columns.col(j) *= weights_(j);
    return columns;
  }
  Matrix product(const Matrix& a, const Matrix& b) const { return Matrix(weighed(a) * b); }
  // X with X = b + a X.
  static Matrix solved(const Matrix& a, const Matrix& b) {
    Matrix x;
    cv::solve(Matrix::eye(a.rows, a.cols) - a, b, x, cv::DECOMP_LU);
    return x;
  }
  Matrix before(const Matrix& kernel) const {  // light that comes straight
    Matrix columns = kernel.clone();
    for (int j = 0; j < columns.cols; ++j) columns.col(j) *= direct_[static_cast<std::size_t>(j)];
    return columns;
  }
  Matrix after(const Matrix& kernel) const {  // light that leaves straight
    Matrix rows = kernel.clone();
    for (int i = 0; i < rows.rows; ++i) rows.row(i) *= direct_[static_cast<std::size_t>(i)];
    return rows;
  }

  // Hansen and Travis, eqs. 3.26 to 3.31, of two equal layers.
  void twice() {
    const Matrix there_and_back = product(reflected_, reflected_);
    const Matrix between = solved(weighed(there_and_back), there_and_back);
    const Matrix down(passed_ + before(between) + product(between, passed_));
    const Matrix up(before(reflected_) + product(reflected_, down));
    reflected_ = Matrix(reflected_ + after(up) + product(passed_, up));
    passed_ = Matrix(after(down) + before(passed_) + product(passed_, down));
    for (double& direct : direct_) direct *= direct;
  }

  const Streams& streams_;
  Matrix reflected_, passed_;  // of the layer, light scattered at least once
  Matrix weights_;
  std::vector<double> direct_;  // light that passes the layer unscattered
};

}  // namespace

HalfSpaceTotals half_space_totals(double absorption) {
  const Streams streams;
  const double scattering = 1 / (1 - kSkinAnisotropy);  // sigma_s / sigma_s'
  HalfSpaceTotals totals;
  const auto node = [&](std::size_t i) { return static_cast<int>(streams.first_node + i); };
  for (int k = 0; k < 3; ++k) {
    const Matrix reflected =
        Doubling(streams, Phase(streams, k), scattering / (scattering + absorption))
            .under_boundary();
    // Radiance over the index squared is what a ray keeps. A series of cosines: twice.
    const double scale = (k > 0 ? 2 : 1) / (kSkinIndex * kSkinIndex);
    for (std::size_t in = 0; in < kAngleNodes; ++in)
      for (std::size_t out = 0; out < kAngleNodes; ++out)
        totals.by_direction[static_cast<std::size_t>(k)][in][out] =
            scale * reflected(node(out), node(in));
    if (k > 0) continue;
    for (std::size_t i = 0; i < streams.first_node; ++i) {
      const double cosine = streams.cosines[i];
      totals.reflectance += 2 * cosine * streams.weights[i] *
                            (1 - fresnel_reflectance(cosine, kSkinIndex, 1)) *
                            reflected(static_cast<int>(i), node(0));
    }
  }
  return totals;
}

}  // namespace hw_sim
