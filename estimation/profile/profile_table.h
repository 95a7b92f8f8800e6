// The paper's lookup table: scattering profiles over R_d (rows) and l_d (columns).
//
// Differs from the paper's in form only: a profile is kept as its harmonics instead of one sample a
// shift (exact at any sub-pixel position, and the optics' transfer multiplies them), and l_d is in
// projector pixels, so that one table serves every pitch (design/estimation.md, section 1).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/stripe_set.h"

namespace estimation {

struct TableRange {
  double least_reflectance = 0.002;
  double greatest_reflectance = 0.998;
  // Far below 0.1 projector px a profile is the stripe itself, above 60 a flat line
  // (design/estimation.md, "Identifiability").
  double least_translucency_px = 0.05;
  double greatest_translucency_px = 60;
};

// c_1, c_2, ... of one material, as many as harmonics() of the table has.
std::vector<float> profile_harmonics(const ScatteringModel& model, StripeShape shape,
                                     double diffuse_reflectance, double translucency_px);

// Immutable once built, thread-safe.
class ProfileTable {
 public:
  static constexpr int kRows = 200;  // R_d, evenly spaced
  static constexpr int kCols = 200;  // l_d, evenly spaced in its logarithm

  // Fills the table in the caller's oneTBB arena; the same bits for any number of threads.
  ProfileTable(const ScatteringModel& model, StripeShape shape, const TableRange& range);

  // Harmonics n = 1, 2, ... of the profile of area one: a pixel at projector position u sees
  //   1 + 2 sum_n c_n m_n cos(2 pi n (u - shift - (width - 1)/2) / period)
  // times its mean under shift. As many as noise lets one see: up to the last above 3e-5.
  std::span<const double> harmonics(int row, int col) const {
    const std::size_t entry = index(row, col);
    return {entry_data(row, entry), visible_counts_[entry]};
  }
  // The same harmonics and those beyond, to where R~ falls below 1e-12 of R_d: the profile to
  // 1e-10, unless it needs more than greatest_harmonic_count() of them.
  std::span<const double> all_harmonics(int row, int col) const {
    const std::size_t entry = index(row, col);
    return {entry_data(row, entry), counts_[entry]};
  }
  int greatest_harmonic_count() const { return static_cast<int>(stride_); }

  // Positions between rows and columns are allowed.
  double row_of(double diffuse_reflectance) const;
  double reflectance_at(int row) const;
  double translucency_px_at(double col) const;
  double log_step() const { return log_step_; }  // of l_d, from column to column

  const TableRange& range() const { return range_; }
  StripeShape shape() const { return shape_; }

 private:
  static std::size_t index(int row, int col) {
    return static_cast<std::size_t>(row) * kCols + static_cast<std::size_t>(col);
  }

  const double* entry_data(int row, std::size_t entry) const {
    return harmonics_.get() + static_cast<std::size_t>(row) * row_stride_ + offsets_[entry];
  }
  void fill_row(const ScatteringModel& model, int row, std::span<const double> k_times_l_d,
                std::span<const double> stripe);

  StripeShape shape_;
  TableRange range_;
  double log_step_ = 0;
  std::size_t stride_ = 0;      // most harmonics an entry can have
  std::size_t row_stride_ = 0;  // R_d and kCols entries
  // [row][row_stride_], of which a row uses the front: its columns one after the other. What
  // lies behind is never touched, so it costs neither time nor memory.
  std::unique_ptr<double[]> harmonics_;
  std::vector<std::uint32_t> offsets_, counts_, visible_counts_;  // [row][col]
};

}  // namespace estimation
