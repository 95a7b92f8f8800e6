#include "hw_sim/display/picture_cache.h"

#include <algorithm>
#include <functional>
#include <string_view>
#include <utility>

namespace hw_sim {
namespace {

std::uint64_t hash_of(const estimation::Image<unsigned char>& image) {
  const auto samples = image.samples();
  return std::hash<std::string_view>{}(
      {reinterpret_cast<const char*>(samples.data()), samples.size()});
}

bool are_equal(const estimation::Image<unsigned char>& a,
               const estimation::Image<unsigned char>& b) {
  return a.width_px() == b.width_px() && a.height_px() == b.height_px() &&
         std::equal(a.samples().begin(), a.samples().end(), b.samples().begin());
}

}  // namespace

std::shared_ptr<const Picture> PictureCache::find(estimation::Image<unsigned char> brightness) {
  const std::uint64_t hash = hash_of(brightness);
  for (std::size_t i = entries_.size(); i-- > 0;) {
    if (entries_[i].hash != hash || !are_equal(entries_[i].picture->brightness, brightness))
      continue;
    std::rotate(entries_.begin() + static_cast<std::ptrdiff_t>(i),
                entries_.begin() + static_cast<std::ptrdiff_t>(i) + 1, entries_.end());
    return entries_.back().picture;
  }
  if (entries_.size() == limit_) entries_.pop_front();
  entries_.push_back({hash, std::make_shared<Picture>(Picture{++last_id_, std::move(brightness)})});
  return entries_.back().picture;
}

}  // namespace hw_sim
