#include "estimation/profile/chance_fits.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

// A block decides for its sites from the 3 x 3 blocks around it.
constexpr int kBlockSites = 5;
// In simulated skin (ssrig-bench, efficiency) errors of ln l_d are 1.4 to 1.7 times their stated
// variance where 70% of the pixels are identifiable, 1.1 to 1.4 times at 80%, once at 85%; where
// half are, 2.5 times and more, and no longer around the truth.
constexpr double kLeastShare = 2.0 / 3;
constexpr double kUsualShare = 0.85;
constexpr double kGainPerShare = 4;
constexpr std::uint32_t kFewestSites = 20;
constexpr std::uint32_t kUntold = kNotIdentifiable | kOutsideModel;

struct Count {
  std::uint32_t told = 0, untold = 0;
};

// Of the sites that had light enough for a fit.
class Counts {
 public:
  Counts(const CameraInfo& camera, const SiteFits& fits)
      : side_px_(kBlockSites * site_step_px(camera)),
        rows_((camera.height_px + side_px_ - 1) / side_px_),
        cols_((camera.width_px + side_px_ - 1) / side_px_),
        counts_(static_cast<std::size_t>(rows_) * static_cast<std::size_t>(cols_)) {
    for (std::size_t i = 0; i < fits.sites.size(); ++i) {
      Count& count = at(fits.sites[i].row / side_px_, fits.sites[i].col / side_px_);
      const std::uint32_t errors = fits.fit.validity[i] & kValidityErrors;
      if (errors == 0)
        ++count.told;
      else if ((errors & kUntold) != 0)
        ++count.untold;
    }
  }

  Count around(Site site) {
    const int row = site.row / side_px_, col = site.col / side_px_;
    Count sum;
    for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rows_ - 1); ++r)
      for (int c = std::max(col - 1, 0); c <= std::min(col + 1, cols_ - 1); ++c) {
        sum.told += at(r, c).told;
        sum.untold += at(r, c).untold;
      }
    return sum;
  }

 private:
  Count& at(int row, int col) {
    return counts_[static_cast<std::size_t>(row) * static_cast<std::size_t>(cols_) +
                   static_cast<std::size_t>(col)];
  }

  int side_px_, rows_, cols_;
  std::vector<Count> counts_;  // [block]
};

}  // namespace

std::optional<double> vague_variance_gain(double identifiable_frac) {
  if (identifiable_frac < kLeastShare) return std::nullopt;
  return 1 + kGainPerShare * std::max(kUsualShare - identifiable_frac, 0.0);
}

std::size_t judge_vague_fits(const CameraInfo& camera, SiteFits& fits) {
  Counts counts(camera, fits);
  BatchFit& fit = fits.fit;
  const float* const log_variance = fit.covariance.data() + covariance_index(1, 1) * fit.stride;
  std::size_t refused_count = 0;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if ((fit.validity[i] & kValidityErrors) != 0 ||
        static_cast<double>(log_variance[i]) < kVagueLogSd * kVagueLogSd)
      continue;
    const Count around = counts.around(fits.sites[i]);
    const std::uint32_t sites = around.told + around.untold;
    if (sites < kFewestSites) continue;
    const auto gain = vague_variance_gain(static_cast<double>(around.told) / sites);
    if (!gain) {
      fit.validity[i] |= kNotIdentifiable;
      ++refused_count;
    } else if (*gain > 1) {
      for (std::size_t entry = i; entry < fit.covariance.size(); entry += fit.stride)
        fit.covariance[entry] *= static_cast<float>(*gain);
    }
  }
  return refused_count;
}

}  // namespace estimation
