#include "estimation/calibration/radiometry_pictures.h"

#include <cmath>
#include <cstdio>
#include <functional>
#include <numbers>

#include "estimation/calibration/chart.h"
#include "estimation/calibration/report_page.h"

namespace estimation {
namespace {

// The one place where OpenCV's exceptions become errors.
Result<void> save_drawn(const std::filesystem::path& folder, const std::string& file,
                        const std::function<plot::Canvas()>& draw) {
  try {
    return save_picture(folder, file, draw());
  } catch (const cv::Exception& problem) {
    return tl::unexpected(InputError{InputFault::kInvalid, (folder / file).string(), "",
                                     "the picture could not be drawn: " + problem.msg});
  }
}

plot::Canvas draw_photon_transfer(const SensorFit& fit) {
  ChartSeries measured{"measured", kBlueInk, false, {}}, fitted{"fitted", kRedInk, true, {}};
  for (const SensorFit::PhotonPoint& point : fit.photon_transfer) {
    measured.points.emplace_back(point.signal_dn, point.variance_dn2);
    fitted.points.emplace_back(point.signal_dn, point.fitted_dn2);
  }
  return draw_chart({"Photon transfer", "signal, DN", "variance, DN^2", {measured, fitted}, true});
}

plot::Canvas draw_linearity(const SensorFit& fit) {
  ChartSeries series{"", kBlueInk, false, {}};
  for (const SensorFit::LinearityPoint& point : fit.linearity)
    series.points.emplace_back(point.signal_dn, 100 * point.deviation_frac);
  return draw_chart({"Deviation from proportionality to exposure",
                     "signal, DN",
                     "deviation, %",
                     {series},
                     false});
}

plot::Canvas draw_vignetting(const IlluminationFit& fit) {
  const plot::Range range = plot::robust_range({fit.vignetting.view()}, 0, 1);
  constexpr int kWidthPx = 640, kMargin = 20, kTop = 50;
  const double scale =
      plot::panel_scale(fit.vignetting.width_px(), fit.vignetting.height_px(), kWidthPx);
  const plot::Canvas picture =
      plot::false_color(plot::resize_for_panel(fit.vignetting.view(), scale).view(), range);
  const plot::Canvas bar = plot::color_bar(range, "", picture.rows);
  plot::Canvas canvas(picture.rows + kTop + kMargin, picture.cols + bar.cols + 3 * kMargin,
                      plot::kWhite);
  plot::draw_text(canvas, "Vignetting over the projector's picture, 1 at its centre", {kMargin, 32},
                  0.55, plot::kInk);
  plot::paste(picture, {kMargin, kTop}, canvas);
  plot::paste(bar, {2 * kMargin + picture.cols, kTop}, canvas);
  return canvas;
}

plot::Canvas draw_residuals(const IlluminationFit& fit) {
  constexpr double kBandStepPx = 7;
  Chart chart{
      "The standard over the fit, cell by cell", "projector column, px", "residual, %", {}, false};
  for (int band = 0; band < fit.band_count; ++band) {
    ChartSeries series{std::string(1, "RGB"[band]), band_color(band), false, {}};
    for (const IlluminationFit::Cell& cell : fit.cells)
      // Beside each other, so that no band hides another.
      if (cell.band == band)
        series.points.emplace_back(cell.column_px + kBandStepPx * (band - 1),
                                   100 * cell.residual_frac);
    chart.series.push_back(series);
  }
  return draw_chart(chart);
}

double gaussian_contrast(double n, double blur_px) {
  const double k = 2 * std::numbers::pi * n / 40;
  return std::exp(-k * k * blur_px * blur_px / 2);
}

plot::Canvas draw_curves(const TransferFit& fit) {
  std::string title;
  print(title, "Contrast of the optics at %.0f mm%s", fit.distance_mm,
        fit.scattering.is_scattering ? ": the target scatters" : "");
  Chart chart{title, "cycles per 40 projector px", "contrast", {}, true};
  for (int band = 0; band < fit.band_count; ++band) {
    const TransferCurve& curve = fit.bands[static_cast<std::size_t>(band)];
    std::string name(1, "RGB"[band]);
    print(name, ", blur %.2f px", curve.blur_px.value);
    ChartSeries measured{name, band_color(band), false, {}};
    ChartSeries fitted{"", band_color(band), true, {}};
    for (int n = 1; n <= kTransferHarmonics; ++n)
      measured.points.emplace_back(n, curve.contrast[static_cast<std::size_t>(n - 1)].value);
    for (double n = 0; n <= kTransferHarmonics; n += 0.25)
      fitted.points.emplace_back(n, gaussian_contrast(n, curve.blur_px.value));
    chart.series.push_back(measured);
    chart.series.push_back(fitted);
  }
  return draw_chart(chart);
}

}  // namespace

std::string describe_sensor(const SensorFit& fit) {
  std::string text;
  print(text, "black level    %10.3f DN     +- %.3f\n", fit.black_level_dn.value,
        fit.black_level_dn.sd);
  print(text, "dark signal    %10.3g DN/us  +- %.2g\n", fit.dark_signal_dn_per_us.value,
        fit.dark_signal_dn_per_us.sd);
  print(text, "gain           %10.4f e-/DN  +- %.4f\n", fit.gain_e_per_dn.value,
        fit.gain_e_per_dn.sd);
  print(text, "read noise     %10.3f e-     +- %.3f\n", fit.read_noise_e.value,
        fit.read_noise_e.sd);
  print(text, "linearity      %10.3f %% at most\n", 100 * fit.linearity_max_frac.value);
  print(text, "for the rig file's [camera]:\n");
  print(text, "  black_level_dn = %.2f\n  gain_e_per_dn = %.4f\n  read_noise_e = %.3f\n",
        fit.black_level_dn.value, fit.gain_e_per_dn.value, fit.read_noise_e.value);
  return text;
}

std::string describe_light(const LightCheck& check) {
  std::string text;
  print(text, "white          %10.5f DN/us, repeats differ by %.3f%%\n",
        check.white_dn_per_us.value, 100 * check.white_change_frac);
  print(text, "black          %10.6f DN/us, repeats differ by %.3f%% of white\n",
        check.black_dn_per_us.value, 100 * check.black_change_frac);
  if (check.gamma.value > 0)
    print(text, "gamma          %10.3f        +- %.3f\n", check.gamma.value, check.gamma.sd);
  return text;
}

std::string describe_illumination(const IlluminationFit& fit) {
  std::string text;
  print(text, "reference distance %.2f mm, standard flat to %.3f mm rms\n",
        fit.reference_distance_mm, fit.flatness_mm);
  for (int band = 0; band < fit.band_count; ++band) {
    const auto b = static_cast<std::size_t>(band);
    print(text, "%c signal       %10.6f DN/us  +- %.2g", "RGB"[band], fit.signal_per_us[b].value,
          fit.signal_per_us[b].sd);
    if (fit.has_black)
      print(text, ", black %.3g +- %.1g", fit.projector_black_dn_per_us[b].value,
            fit.projector_black_dn_per_us[b].sd);
    text += "\n";
  }
  print(text,
        "vignetting of order %d from columns %.0f..%.0f, rows %.0f..%.0f; residual %.2f%% rms\n",
        fit.order, fit.first_column_px, fit.last_column_px, fit.first_row_px, fit.last_row_px,
        100 * fit.residual_rms_frac);
  return text;
}

std::string describe_transfer(const TransferFit& fit) {
  std::string text;
  print(text, "at %.1f mm, %zu blocks\n", fit.distance_mm, fit.blocks.size());
  for (int band = 0; band < fit.band_count; ++band) {
    const TransferCurve& curve = fit.bands[static_cast<std::size_t>(band)];
    print(text, "%c blur %.3f +- %.3f px; contrast", "RGB"[band], curve.blur_px.value,
          curve.blur_px.sd);
    for (const Measured& m : curve.contrast) print(text, " %.4f", m.value);
    text += "\n";
  }
  print(text, "chi-square %.1f as blur, %.1f as blur and scattering\n", fit.scattering.chi2_blur,
        fit.scattering.chi2_scattering);
  return text;
}

Result<void> draw_sensor(const std::filesystem::path& folder, const SensorFit& fit) {
  const auto saved =
      save_drawn(folder, "photon_transfer.png", [&] { return draw_photon_transfer(fit); });
  if (!saved || fit.linearity.empty()) return saved;
  return save_drawn(folder, "linearity.png", [&] { return draw_linearity(fit); });
}

Result<void> draw_illumination(const std::filesystem::path& folder, const IlluminationFit& fit) {
  const auto saved = save_drawn(folder, "vignetting.png", [&] { return draw_vignetting(fit); });
  if (!saved) return saved;
  return save_drawn(folder, "standard_residuals.png", [&] { return draw_residuals(fit); });
}

Result<void> draw_transfer(const std::filesystem::path& folder, std::span<const TransferFit> fits) {
  for (std::size_t i = 0; i < fits.size(); ++i) {
    std::string file = "transfer_";
    file.append(std::to_string(i + 1)).append(".png");
    if (const auto saved = save_drawn(folder, file, [&] { return draw_curves(fits[i]); }); !saved)
      return saved;
  }
  return {};
}

}  // namespace estimation
