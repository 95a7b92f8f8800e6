#include "tests/bench/pixels.h"

#include <oneapi/tbb/parallel_for.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>

namespace bench {

using estimation::truth::PixelRandom;
using estimation::truth::View;

std::vector<NamedMedium> table_2(const std::string& file) {
  std::ifstream stream(file);
  if (!stream) {
    std::fprintf(stderr, "ssrig-bench: cannot read %s\n", file.c_str());
    std::exit(1);
  }
  std::vector<NamedMedium> media;
  for (std::string line; std::getline(stream, line);) {
    if (!line.starts_with("female,") && !line.starts_with("male,")) continue;
    std::vector<std::string> fields;
    std::stringstream row(line);
    for (std::string field; std::getline(row, field, ',');) fields.push_back(field);
    if (fields[1] == "std") continue;
    static constexpr std::array<const char*, 3> kColours{"red", "green", "blue"};
    for (std::size_t colour = 0; colour < kColours.size(); ++colour)
      media.push_back({fields[0] + " " + fields[1] + " " + kColours[colour],
                       {.sigma_a_per_mm = std::stod(fields[2 + colour]),
                        .sigma_s_prime_per_mm = std::stod(fields[5 + colour])}});
  }
  return media;
}

std::vector<int> even_shifts(int period_px, int count) {
  std::vector<int> shifts;
  for (int i = 0; i < count; ++i) shifts.push_back(i * period_px / count);
  return shifts;
}

estimation::PixelBatch PixelSet::batch(std::size_t first, std::size_t block_count) const {
  const auto from = [&](const std::vector<float>& rows) {
    return std::span<const float>(rows).subspan(rows.empty() ? 0 : first);
  };
  return {.count = block_count,
          .stride = stride,
          .samples = from(samples),
          .position_px = from(position_px),
          .full_signal = from(full_signal),
          .factor_re = from(factor_re),
          .factor_im = from(factor_im),
          .factor_count = factor_count,
          .offset_px = offset_px};
}

PixelSet simulate(const PixelPlan& plan) {
  PixelSet set{.shape = plan.shape,
               .shifts_px = plan.shifts_px,
               .noise = plan.sensor.noise(),
               .subjects = plan.subjects,
               .count = plan.count,
               .stride = (plan.count + 15) / 16 * 16,
               .samples = {},
               .samples_by_pixel = {},
               .position_px = {},
               .full_signal = {},
               .true_u_px = {},
               .indirect = plan.view.indirect};
  const std::size_t shift_count = plan.shifts_px.size();
  const auto full_signal = static_cast<float>(plan.sensor.full_signal_dn_per_us());
  set.samples.assign(shift_count * set.stride, 0);
  set.samples_by_pixel.assign(shift_count * plan.count, 0);
  set.position_px.assign(set.stride, 0);
  set.full_signal.assign(set.stride, full_signal);
  set.true_u_px.assign(plan.count, 0);
  tbb::parallel_for(std::size_t{0}, plan.count, [&](std::size_t pixel) {
    PixelRandom random(plan.seed * 0x9e3779b97f4a7c15U ^ (pixel + 1) * 0xd1342543de82ef95U);
    View view = plan.view;
    view.u_px = 200 + 600 * random.uniform();
    set.true_u_px[pixel] = view.u_px;
    set.position_px[pixel] =
        static_cast<float>(view.u_px + plan.position_error_px * (2 * random.uniform() - 1));
    const Subject& subject = set.subject(pixel);
    const std::vector<double> factors =
        sweep(*subject.curve, plan.shape, plan.shifts_px, view, plan.order);
    for (std::size_t i = 0; i < shift_count; ++i) {
      const auto sample = static_cast<float>(plan.sensor.read(factors[i], random));
      set.samples[i * set.stride + pixel] = sample;
      set.samples_by_pixel[pixel * shift_count + i] = sample;
    }
  });
  return set;
}

}  // namespace bench
