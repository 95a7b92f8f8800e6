// Subsurface light transport: each camera sample's response to the projector's columns, to its
// rows, and, slowly, to any picture. Integrated over the lit surface in space, paper eq. 7, with
// the kernel of the material at the seen point: eq. 3's dipole, or Monte Carlo's by direction.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <iosfwd>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/world/dipole.h"
#include "hw_sim/world/lamp_response.h"
#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/split_picture.h"

namespace hw_sim {

class ScatterTable;

// A sample of the camera that sees the surface: one for mono and Bayer pixels, three for RGB, and
// three each where the projector's colours mix.
struct SeenSample {
  std::array<float, 3> point_mm{};
  std::array<float, 3> normal{};
  std::int32_t sample = 0;  // index into the frame's samples
  float cos_projector = 0;  // between normal and the direction to the projector
  Scattering scattering;    // of its light's band
  float share = 1;          // of the frame's sample: bands mix where the projector's colours do
};

// What the optics do to the lines of light on their way to each sample.
struct LineOptics {
  LampResponse lamp;
  std::vector<float> blur_px;                  // [sample] of projector px; empty: none
  std::array<std::vector<float>, 2> shift_px;  // [axis][sample] that light arrives displaced by
};

using Progress = std::function<void(double done_frac)>;

// Immutable after build or load, so thread-safe. Refers to the samples and the light it was built
// with; both must outlive it.
class Transport {
 public:
  // Runs in the caller's TBB arena; the same bytes for any number of threads. `progress` is called
  // from one thread at a time.
  //   table  of the skin's scattering, must outlive the transport; null: the paper's dipole
  static Transport build(const std::vector<SeenSample>& samples, const ProjectorLight& light,
                         const ScatterTable* table, const Progress& progress);
  void save(std::ostream& out) const;
  // False on a short stream or one made for another number of samples.
  bool load(std::istream& in, const std::vector<SeenSample>& samples, const ProjectorLight& light,
            const ScatterTable* table);

  // Each sample's reflectance factor (irradiance not normalised) under a picture. Runs in the
  // caller's arena. Pictures of columns or rows pass through `optics`; others, and a sync square,
  // through its gamma and its mean blur.
  std::vector<float> reflected(estimation::ImageView<const unsigned char> brightness,
                               const LineOptics& optics) const;

 private:
  struct Window {
    std::int64_t offset = 0;  // into responses_
    std::int32_t begin = 0;   // first column (row)
    std::int32_t count = 0;
    float scale = 0;  // response per full brightness = scale * stored
    std::int32_t unused = 0;
  };
  struct Entry {
    std::array<Window, 2> windows;  // columns, rows
    SplitPicture::Rect reach;       // projector pixels within the kernel's radius
    std::int32_t is_fine = 0;       // summed on the finer lattice
    std::int32_t unused = 0;
  };
  struct Worker;

  void add_line(std::size_t axis, const std::vector<unsigned char>& line,
                std::vector<float>& reflected) const;
  void add_blurred_line(std::size_t axis, const std::vector<unsigned char>& line,
                        const LineOptics& optics, std::vector<float>& reflected) const;
  void add_rest(estimation::ImageView<const unsigned char> brightness, const SplitPicture& split,
                const LineOptics& optics, std::vector<float>& reflected) const;

  const std::vector<SeenSample>* samples_ = nullptr;
  const ProjectorLight* light_ = nullptr;
  const ScatterTable* table_ = nullptr;
  std::vector<Entry> entries_;  // one a sample
  std::vector<std::uint16_t> responses_;
};

}  // namespace hw_sim
