#include "estimation/geometry/signal_rows.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

#include "estimation/base/check.h"

namespace estimation {
namespace {

Image<float> average(const std::vector<ImageView<const float>>& views) {
  Image<float> mean(views[0].height_px, views[0].width_px);
  const float weight = 1.0F / static_cast<float>(views.size());
  for (const auto& view : views) {
    for (int row = 0; row < view.height_px; ++row) {
      const auto from = view.row(row);
      const auto to = mean.view().row(row);
      for (std::size_t col = 0; col < to.size(); ++col) to[col] += weight * from[col];
    }
  }
  return mean;
}

// One pattern's signals, however often it was seen.
struct Group {
  SignalSource source;
  std::vector<ImageView<const float>> views;
};

void check_size(const SignalSet& set, int height_px, int width_px, int channel_count) {
  check(height_px == set.height_px && width_px == set.width_px && channel_count == 1,
        "signals of different sizes");
}

}  // namespace

SignalSet collect_signals(std::span<const PatternSignal> signals, const FrameLevels& levels) {
  check(!signals.empty(), "correspondence of no signals");
  const auto size_of = [](const PatternSignal& signal) {
    return signal.frames.empty()
               ? std::pair(signal.signal.height_px, signal.signal.width_px)
               : std::pair(signal.frames[0].dn.height_px, signal.frames[0].dn.width_px);
  };
  SignalSet set;
  std::tie(set.height_px, set.width_px) = size_of(signals[0]);
  set.black = levels.black;
  // Whole numbers are below a level exactly if they are below its next whole number.
  set.saturation_dn = static_cast<float>(std::ceil(std::clamp(levels.saturation_dn, 0.0, 1e5)));
  std::vector<Group> groups;
  for (const PatternSignal& signal : signals) {
    auto group = std::find_if(groups.begin(), groups.end(), [&](const Group& other) {
      return *other.source.kind == *signal.kind &&
             other.source.frames.empty() == signal.frames.empty();
    });
    if (group == groups.end()) group = groups.insert(group, Group{{signal.kind, {}, {}}, {}});
    for (const ExposedFrame& frame : signal.frames) {
      check(set.black != nullptr, "frames without the camera's black");
      check_size(set, frame.dn.height_px, frame.dn.width_px, frame.dn.channel_count);
      group->source.frames.push_back(frame);
    }
    if (!signal.frames.empty()) continue;
    check_size(set, signal.signal.height_px, signal.signal.width_px, signal.signal.channel_count);
    group->views.push_back(signal.signal);
  }
  for (Group& group : groups) {
    if (group.views.size() == 1) group.source.merged = group.views[0];
    if (group.views.size() > 1) {
      set.averages.push_back(average(group.views));
      group.source.merged = std::as_const(set.averages.back()).view();
    }
    std::stable_sort(group.source.frames.begin(), group.source.frames.end(),
                     [](const auto& a, const auto& b) { return a.exposure_us < b.exposure_us; });
    set.sources.push_back(std::move(group.source));
  }
  return set;
}

SignalRows::SignalRows(const SignalSet& set) : set_(set) {
  const auto width = static_cast<std::size_t>(set.width_px);
  for (const SignalSource& source : set.sources)
    for (const ExposedFrame& frame : source.frames) {
      const bool is_known = std::any_of(blacks_.begin(), blacks_.end(), [&](const Black& black) {
        return black.exposure_us == frame.exposure_us;
      });
      if (!is_known) blacks_.push_back({frame.exposure_us, std::vector<float>(width)});
    }
  for (const SignalSource& source : set.sources) {
    first_.push_back(exposed_.size());
    for (const ExposedFrame& frame : source.frames) {
      const auto black = std::find_if(blacks_.begin(), blacks_.end(), [&](const Black& other) {
        return other.exposure_us == frame.exposure_us;
      });
      exposed_.push_back({nullptr, black->dn.data(), static_cast<float>(frame.exposure_us)});
    }
  }
  first_.push_back(exposed_.size());
  if (set.black == nullptr || !set.black->is_one_level()) return;
  for (Black& black : blacks_) set.black->row(black.exposure_us, 0, black.dn);
}

void SignalRows::open(int row) {
  row_ = row;
  std::size_t i = 0;
  for (const SignalSource& source : set_.sources)
    for (const ExposedFrame& frame : source.frames) exposed_[i++].dn = frame.dn.row(row).data();
  if (set_.black == nullptr || set_.black->is_one_level()) return;
  for (Black& black : blacks_) set_.black->row(black.exposure_us, row, black.dn);
}

SampleRow SignalRows::at(std::size_t signal) const {
  const SignalSource& source = set_.sources[signal];
  if (!source.merged.empty()) return {source.merged.row(row_).data(), {}, source.merged.stride};
  return {nullptr, std::span(exposed_).subspan(first_[signal], first_[signal + 1] - first_[signal]),
          source.frames.front().dn.stride};
}

float SignalRows::sample(std::size_t signal, std::size_t col) const {
  const SampleRow row = at(signal);
  if (row.merged != nullptr) return row.merged[col];
  float sum_dn = 0, sum_us = 0;
  for (const ExposedRow& exposed : row.exposures) {
    const auto dn = static_cast<float>(exposed.dn[col]);
    if (dn >= set_.saturation_dn) continue;
    sum_dn += dn - exposed.black_dn[col];
    sum_us += exposed.exposure_us;
  }
  return sum_us > 0 ? sum_dn / sum_us : std::numeric_limits<float>::quiet_NaN();
}

void SignalRows::copy(std::size_t signal, std::span<float> out) const {
  for (std::size_t col = 0; col < out.size(); ++col) out[col] = sample(signal, col);
}

}  // namespace estimation
