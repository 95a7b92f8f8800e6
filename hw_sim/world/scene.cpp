#include "hw_sim/world/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace hw_sim {

using estimation::Vec3;

namespace {

constexpr Material material(double ar, double ag, double ab, double sr, double sg, double sb) {
  return {{{{ar, sr}, {ag, sg}, {ab, sb}}}};
}

// Tariq et al., "Efficient Estimation of Spatially Varying Subsurface Scattering Parameters"
// (2006), Table 2: sigma_a R G B, sigma_s' R G B, 1/mm. As printed: the man's forehead absorbs more
// red than green, and looks it.
constexpr Material kFemaleLips = material(0.0657, 0.2505, 0.2835, 1.102, 0.9084, 0.7982);
constexpr Material kFemaleForehead = material(0.0836, 0.1774, 0.2554, 1.3079, 1.5042, 1.1741);
constexpr Material kFemaleCheek = material(0.0525, 0.1653, 0.2216, 1.2814, 1.5000, 1.1248);
constexpr Material kFemaleMean = material(0.075, 0.156, 0.2254, 1.3881, 1.5017, 1.0969);
constexpr Material kMaleLips = material(0.3227, 0.6631, 0.6833, 0.7819, 0.6710, 0.5209);
constexpr Material kMaleForehead = material(0.4761, 0.3163, 0.442, 1.1415, 1.2267, 0.8851);
constexpr Material kMaleStubble = material(0.4056, 0.6024, 0.6707, 0.9237, 0.8621, 0.6648);
constexpr Material kMaleMean = material(0.2047, 0.3595, 0.4691, 1.1602, 1.1586, 0.8373);

// Jensen et al., "A Practical Model for Subsurface Light Transport" (2001), their table.
constexpr Material kJensenSkin1 = material(0.032, 0.17, 0.48, 0.74, 0.88, 1.01);
constexpr Material kJensenSkin2 = material(0.013, 0.070, 0.145, 1.09, 1.59, 1.79);
constexpr Material kJensenChicken2 = material(0.018, 0.088, 0.20, 0.19, 0.25, 0.32);

constexpr double kBorderHalfWidthMm = 2;

// Signed distances in the frontal plane (x, y), negative inside. Frontal distances are never longer
// than those along the skin, so border distances err on the safe side.
double rounded_box(double x, double y, double half_x, double half_y, double radius) {
  const double qx = std::abs(x) - half_x + radius, qy = std::abs(y) - half_y + radius;
  return std::hypot(std::max(qx, 0.0), std::max(qy, 0.0)) + std::min(std::max(qx, qy), 0.0) -
         radius;
}

double ellipse(double x, double y, double half_x, double half_y) {
  const double k0 = std::hypot(x / half_x, y / half_y);
  const double k1 = std::hypot(x / (half_x * half_x), y / (half_y * half_y));
  return k1 < 1e-9 ? -std::min(half_x, half_y) : k0 * (k0 - 1) / k1;
}

double forehead(double x, double y) { return rounded_box(x, y + 52, 44, 24, 14); }
double cheek(double x, double y) { return ellipse(std::abs(x) - 40, y - 34, 20, 22); }
double stubble(double x, double y) { return rounded_box(x, y - 80, 50 + 0.15 * (80 - y), 32, 18); }
// The red of the lips: two arcs' worth, higher in the middle.
double lips(double x, double y) {
  const double bow = 1.2 * std::exp(-x * x / 18);  // the dip of the upper lip
  return ellipse(x, y - 62.8 - (y < 62.8 ? -bow : 0) * 0.5, 23.5, 9.5);
}

// What is seen of an eye between open lids.
double eye(double x, double y) { return ellipse(std::abs(x) - 30.5, y - 5.2, 11.5, 4.8); }

struct Patch {
  double (*signed_distance_mm)(double x, double y);
  Region region;
  Material material;
};

class FaceSkin final : public SkinMap {
 public:
  FaceSkin(const Vec3& center_mm, const Material& elsewhere, std::vector<Patch> patches)
      : center_(center_mm), elsewhere_(elsewhere), patches_(std::move(patches)) {}

  Skin at(const Vec3& point_mm) const override {
    const Vec3 p = point_mm - center_;
    Skin skin{elsewhere_, Region::kElsewhere, std::numeric_limits<double>::infinity(),
              eye(p[0], p[1]) < 0};
    for (const Patch& patch : patches_) {
      const double distance_mm = patch.signed_distance_mm(p[0], p[1]);
      const double share = 1 - smooth_step(distance_mm / kBorderHalfWidthMm);
      if (share > 0.5) skin.region = patch.region;
      if (!same(patch.material, elsewhere_))
        skin.border_distance_mm = std::min(
            skin.border_distance_mm, std::max(0.0, std::abs(distance_mm) - kBorderHalfWidthMm));
      if (share > 0) mix(skin.material, patch.material, share);
    }
    return skin;
  }

 private:
  static double smooth_step(double x) {  // 0 below -1, 1 above 1
    const double t = std::clamp((x + 1) / 2, 0.0, 1.0);
    return t * t * (3 - 2 * t);
  }
  static bool same(const Material& a, const Material& b) { return a.bands == b.bands; }
  static double mixed(double a, double b, double share) {
    if (share >= 1) return b;
    return a * std::pow(b / a, share);
  }
  static void mix(Material& base, const Material& over, double share) {
    for (std::size_t band = 0; band < 3; ++band) {
      Scattering& a = base.bands[band];
      const Scattering& b = over.bands[band];
      a = {mixed(a.sigma_a_per_mm, b.sigma_a_per_mm, share),
           mixed(a.sigma_s_prime_per_mm, b.sigma_s_prime_per_mm, share)};
    }
  }

  Vec3 center_;
  Material elsewhere_;
  std::vector<Patch> patches_;  // later ones lie over earlier ones
};

// The whole phantom is one material: the paper's female cheek.
class PhantomSkin final : public SkinMap {
 public:
  Skin at(const Vec3& /*point_mm*/) const override {
    return {kFemaleCheek, Region::kCheek, std::numeric_limits<double>::infinity(), false};
  }
};

// Puts the cheeks near z = 1000 mm: the head's own origin lies between the ears.
const Vec3 kHeadCenterMm(0, 2, 1068);

Scene female_face() {
  return {make_head({}, kHeadCenterMm),
          std::make_unique<FaceSkin>(kHeadCenterMm, kFemaleMean,
                                     std::vector<Patch>{
                                         {forehead, Region::kForehead, kFemaleForehead},
                                         {cheek, Region::kCheek, kFemaleCheek},
                                         {lips, Region::kLips, kFemaleLips},
                                     })};
}

HeadProportions a_mans() {
  HeadProportions with;
  with.jaw_width_mm = 29;
  with.chin_mm = 18;
  with.brow_mm = 8.5;
  with.nose_width_mm = 8;
  with.nose_length_mm = 24;
  with.lip_mm = 3.8;
  with.neck_mm = 52;
  return with;
}

Scene male_face() {
  // The table has no row for a man's cheek: it is the mean, and its rim is no border.
  return {make_head(a_mans(), kHeadCenterMm),
          std::make_unique<FaceSkin>(kHeadCenterMm, kMaleMean,
                                     std::vector<Patch>{
                                         {forehead, Region::kForehead, kMaleForehead},
                                         {cheek, Region::kCheek, kMaleMean},
                                         {stubble, Region::kStubble, kMaleStubble},
                                         {lips, Region::kLips, kMaleLips},
                                     })};
}

Scene wax_bust() {
  return {make_head(a_mans(), kHeadCenterMm),
          std::make_unique<FaceSkin>(kHeadCenterMm, kJensenSkin1,
                                     std::vector<Patch>{
                                         {forehead, Region::kForehead, kJensenSkin2},
                                         {cheek, Region::kCheek, kJensenSkin2},
                                         {lips, Region::kLips, kJensenChicken2},
                                     })};
}

Scene phantom(std::unique_ptr<Shape> shape) {
  return {std::move(shape), std::make_unique<PhantomSkin>()};
}

}  // namespace

std::vector<std::string> scene_names() {
  return {"face_female", "face_male", "flat_phantom", "tilted_phantom",
          "wedge",       "sphere",    "wax_bust",     "empty"};
}

rig::Result<Scene> make_scene(const std::string& name) {
  if (name == "face_female") return female_face();
  if (name == "face_male") return male_face();
  if (name == "flat_phantom") return phantom(make_slab({0, 0, 1000}, 110, 90, 0));
  if (name == "tilted_phantom")
    return phantom(make_slab({0, 0, 1000}, 110, 90, std::numbers::pi / 6));
  if (name == "wedge") return phantom(make_wedge({0, 0, 1027}, 110, 85, std::numbers::pi / 6));
  if (name == "wax_bust") return wax_bust();
  if (name == "sphere") return phantom(make_sphere({0, 0, 1060}, 80));
  if (name == "empty") return phantom(nullptr);
  std::string known;
  for (const std::string& each : scene_names()) known += (known.empty() ? "" : ", ") + each;
  return rig::failure(rig::Fault::kConfiguration,
                      "there is no scene \"" + name + "\"; the scenes are " + known);
}

}  // namespace hw_sim
