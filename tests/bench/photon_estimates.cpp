#include "tests/bench/photon_estimates.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>

#include "estimation/estimator.h"

namespace bench {

namespace {

constexpr double kExposures_us[] = {16667, 66667};  // config/simulated.toml

[[noreturn]] void stop(const estimation::InputError& error) {
  std::cerr << "photon-windows: " << error.text() << "\n";
  std::exit(1);
}

estimation::Image<std::uint16_t> frame_of(const Window& window, const std::vector<double>& factors,
                                          double exposure_us) {
  const estimation::Manifest& m = window.manifest;
  const double black = *m.camera.black_level_dn;
  estimation::Image<std::uint16_t> frame(m.camera.height_px, m.camera.width_px, 1,
                                         static_cast<std::uint16_t>(black));
  for (std::size_t i = 0; i < window.pixels.size(); ++i) {
    const WindowPixel& pixel = window.pixels[i];
    const double rate =
        m.calibration.irradiance->signal_per_us[static_cast<std::size_t>(pixel.band)];
    const double dn = black + factors[i] * rate * exposure_us;
    frame.at(pixel.row, pixel.col) =
        static_cast<std::uint16_t>(std::lround(std::clamp(dn, 0.0, 4095.0)));
  }
  return frame;
}

}  // namespace

std::vector<Recovered> recover(const Window& window, const Signals& signals, int thread_count) {
  estimation::Manifest manifest = window.manifest;
  for (const estimation::Pattern& pattern : manifest.patterns)
    for (const double exposure_us : kExposures_us) {
      estimation::FrameRecord& frame = manifest.frames.emplace_back();
      frame.pattern = pattern.index;
      frame.exposure_us = exposure_us;
    }
  estimation::EstimatorOptions options;
  options.model = "monte_carlo_angular";
  options.thread_count = thread_count;
  auto estimator = estimation::Estimator::create(manifest, {}, options);
  if (!estimator) stop(estimator.error());
  std::size_t frame = 0;
  for (const std::vector<double>& factors : signals)
    for (const double exposure_us : kExposures_us) {
      const auto image = frame_of(window, factors, exposure_us);
      if (const auto added = (*estimator)->add_frame(frame++, image.view()); !added)
        stop(added.error());
    }
  const auto maps = (*estimator)->finish();
  if (!maps) stop(maps.error());
  std::vector<Recovered> found;
  for (const WindowPixel& pixel : window.pixels) {
    const auto band = static_cast<std::size_t>(pixel.band);
    const auto at = [&](const estimation::BandMaps& map) {
      return map[band].empty() ? std::nan("")
                               : static_cast<double>(map[band].at(pixel.row, pixel.col));
    };
    Recovered r{at(maps->sigma_a_per_mm), at(maps->sigma_s_prime_per_mm),
                at(maps->translucency_mm)};
    r.is_valid =
        (maps->validity[band].at(pixel.row, pixel.col) & estimation::kValidityErrors) == 0 &&
        std::isfinite(r.sigma_a_per_mm + r.sigma_s_prime_per_mm + r.translucency_mm);
    found.push_back(r);
  }
  return found;
}

}  // namespace bench
