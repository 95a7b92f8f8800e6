// What stripes keep of their contrast in a flat phantom, by the volume's photons and with as little
// of their noise as symmetry allows: at 0.5/mm light from afar adds nothing in the mean and was
// nearly all of the noise.
//
// A half space is the same from all sides. Wherever a path's azimuth has been forgotten it may be
// turned about the normal there, and the mean over all turns is known: a stretch between two such
// places that ends d away from where it began turns exp(i k x) into J0(k d), so that the factors of
// several multiply and die away. The azimuth is forgotten, by chance, at every scattering: the
// phase function is what it is on the far side for every azimuth, plus the rest of it. Paths of
// which little is left are thinned by chance. Both are exact in the mean.
#pragma once

#include <complex>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "hw_sim/photons/matter.h"

namespace hw_sim {

struct FlatView {
  estimation::Vec3 towards_lamp{0, 0, -1};
  std::optional<estimation::Vec3> towards_eye;  // none: all, by Lambert's law
};
struct Harmonic {
  std::complex<double> value;
  double standard_error = 0;  // of real and imaginary part, the larger
};

// What a pattern exp(2 pi i f x) reflects: pi times the radiance at x = 0 over incident flux. Runs
// in the caller's TBB arena; the same numbers for any number of threads.
std::vector<Harmonic> flat_harmonics(const VolumeOptics& optics, const FlatView& view,
                                     std::span<const double> freqs_per_mm, int paths,
                                     std::uint64_t seed);

}  // namespace hw_sim
