#include "estimation/profile/chance_fits.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

// A block decides for its sites from the 3 x 3 blocks around it.
constexpr int kBlockSites = 5;
// In simulated skin 70 to 80% are identifiable where the bound of ln l_d is 0.3, and 88% of those
// lie within two of their standard deviations. At a bound of 0.5 half are, and 80% of them do.
constexpr double kLeastShare = 2.0 / 3;
constexpr std::uint32_t kFewestSites = 20;
constexpr float kVagueLogVariance = 0.1F * 0.1F;
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

std::size_t refuse_chance_fits(const CameraInfo& camera, SiteFits& fits) {
  Counts counts(camera, fits);
  const float* const log_variance =
      fits.fit.covariance.data() + covariance_index(1, 1) * fits.fit.stride;
  std::size_t refused_count = 0;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if ((fits.fit.validity[i] & kValidityErrors) != 0 || log_variance[i] < kVagueLogVariance)
      continue;
    const Count around = counts.around(fits.sites[i]);
    const std::uint32_t sites = around.told + around.untold;
    if (sites < kFewestSites || around.told >= kLeastShare * sites) continue;
    fits.fit.validity[i] |= kNotIdentifiable;
    ++refused_count;
  }
  return refused_count;
}

}  // namespace estimation
