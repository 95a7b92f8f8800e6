#include "hw_sim/world/surface.h"

#include <embree3/rtcore.h>

#include <cmath>
#include <cstring>
#include <limits>

namespace hw_sim {

using estimation::Vec3;

namespace {

// Cells of 1.25 mm put the facets within 0.05 mm of the smooth surface at a lip's curvature.
constexpr double kCellMm = 1.25;

RTCRay to_embree(const Ray& ray, double near_mm, double far_mm) {
  RTCRay out{};
  out.org_x = static_cast<float>(ray.origin_mm[0]);
  out.org_y = static_cast<float>(ray.origin_mm[1]);
  out.org_z = static_cast<float>(ray.origin_mm[2]);
  out.dir_x = static_cast<float>(ray.direction[0]);
  out.dir_y = static_cast<float>(ray.direction[1]);
  out.dir_z = static_cast<float>(ray.direction[2]);
  out.tnear = static_cast<float>(near_mm);
  out.tfar = static_cast<float>(far_mm);
  out.mask = std::numeric_limits<unsigned>::max();
  return out;
}

// The hit moved along its ray onto the shape. Where the ray only grazes the surface the facet's
// point stands: it is within 0.05 mm.
Vec3 refined(const Shape& shape, const Ray& ray, double distance_mm) {
  constexpr double kStep = 1e-3;
  double t = distance_mm;
  for (int i = 0; i < 3; ++i) {
    const double value = shape.distance_mm(ray.origin_mm + t * ray.direction);
    const double next = shape.distance_mm(ray.origin_mm + (t + kStep) * ray.direction);
    const double slope = (next - value) / kStep;
    if (slope > -0.1) break;
    t -= value / slope;
    if (std::abs(value) < 1e-5) break;
  }
  if (std::abs(t - distance_mm) > 0.5) t = distance_mm;
  return ray.origin_mm + t * ray.direction;
}

}  // namespace

struct Surface::Embree {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;

  explicit Embree(const Mesh& mesh) {
    // Not "threads=1": Embree's scheduler is TBB here, and one thread for it would be one for all
    // of the process (tbb::global_control) as long as the device lives.
    device = rtcNewDevice("set_affinity=0");
    estimation::check(device != nullptr, "Embree has no device");
    scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    if (mesh.triangle_count() > 0) add(mesh);
    rtcCommitScene(scene);
  }
  void add(const Mesh& mesh) const {
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const std::size_t count = mesh.vertices_mm.size();
    void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                             sizeof(mesh.vertices_mm[0]), count);
    std::memcpy(vertices, mesh.vertices_mm.data(), count * sizeof(mesh.vertices_mm[0]));
    auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), count / 3));
    for (unsigned i = 0; i < count; ++i) indices[i] = i;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
  }
  ~Embree() {
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
  }
  Embree(const Embree&) = delete;
  Embree& operator=(const Embree&) = delete;

  RTCRayHit intersect(const Ray& ray, double near_mm) const {
    RTCRayHit query{};
    query.ray = to_embree(ray, near_mm, 1e5);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, &query);
    return query;
  }
};

Surface::Surface(std::unique_ptr<Shape> shape)
    : shape_(std::move(shape)),
      mesh_(shape_ ? make_mesh(*shape_, kCellMm) : Mesh{}),
      embree_(std::make_unique<Embree>(mesh_)) {}

Surface::~Surface() = default;

std::optional<Hit> Surface::first_hit(const Ray& ray) const {
  const RTCRayHit found = embree_->intersect(ray, 0);
  if (found.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return Hit{refined(*shape_, ray, static_cast<double>(found.ray.tfar)),
             static_cast<int>(found.hit.primID)};
}

int Surface::first_triangle(const Ray& ray, double near_mm) const {
  const RTCRayHit found = embree_->intersect(ray, near_mm);
  if (found.hit.geomID == RTC_INVALID_GEOMETRY_ID) return -1;
  return static_cast<int>(found.hit.primID);
}

bool Surface::is_seen_from(const Vec3& eye_mm, const Vec3& point_mm, const Vec3& normal) const {
  const Vec3 towards_eye = eye_mm - point_mm;
  const double distance_mm = cv::norm(towards_eye);
  if (towards_eye.dot(normal) <= 0) return false;
  // Facets lie up to 0.05 mm outside the smooth surface: start clear of them.
  const Ray ray{point_mm + 0.1 * normal, towards_eye / distance_mm};
  RTCRay query = to_embree(ray, 0.2, distance_mm);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(embree_->scene, &context, &query);
  return query.tfar >= 0;
}

}  // namespace hw_sim
