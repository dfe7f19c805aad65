// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/ray_caster.hpp>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include <embree3/rtcore.h>
#include <tbb/task_arena.h>

#include <loopwise/core/error.hpp>

namespace loopwise {

struct RayCaster::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

RayCaster::RayCaster(const TriangleMesh& mesh) {
  auto impl = std::make_unique<Impl>();
  // SSE2 is available on every x86-64 processor, and one thread builds the scene below. So the tree and the
  // arithmetic are the same on every machine.
  impl->device = rtcNewDevice("isa=sse2");
  if (!impl->device) {
    throw Error("Embree: no device, error " + std::to_string(static_cast<int>(rtcGetDeviceError(nullptr))));
  }
  impl->scene = rtcNewScene(impl->device);
  rtcSetSceneFlags(impl->scene, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_COMPACT));
  rtcSetSceneBuildQuality(impl->scene, RTC_BUILD_QUALITY_MEDIUM);
  if (!mesh.triangles.empty()) {
    RTCGeometry geometry = rtcNewGeometry(impl->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                             3 * sizeof(float), mesh.vertices.size());
    void* triangles = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                              3 * sizeof(std::uint32_t), mesh.triangles.size());
    if (!vertices || !triangles) {
      rtcReleaseGeometry(geometry);
      throw Error("Embree: no memory for " + std::to_string(mesh.triangles.size()) + " triangles");
    }
    auto* coordinate = static_cast<float*>(vertices);
    for (const Eigen::Vector3f& v : mesh.vertices) coordinate = std::copy_n(v.data(), 3, coordinate);
    std::memcpy(triangles, mesh.triangles.data(), mesh.triangles.size() * 3 * sizeof(std::uint32_t));
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(impl->scene, geometry);
    rtcReleaseGeometry(geometry);
  }
  // Embree builds with oneTBB's threads. This arena limits it to the calling thread.
  tbb::task_arena(1, 1).execute([&] { rtcCommitScene(impl->scene); });
  if (const RTCError error = rtcGetDeviceError(impl->device); error != RTC_ERROR_NONE) {
    throw Error("Embree: cannot build the scene, error " + std::to_string(static_cast<int>(error)));
  }
  impl_ = std::move(impl);
}

RayCaster::~RayCaster() = default;

std::optional<RayHit> RayCaster::cast(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction,
                                      float max_distance_m) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit query;
  query.ray.org_x = origin.x();
  query.ray.org_y = origin.y();
  query.ray.org_z = origin.z();
  query.ray.dir_x = direction.x();
  query.ray.dir_y = direction.y();
  query.ray.dir_z = direction.z();
  query.ray.tnear = 0.0F;
  query.ray.tfar = max_distance_m;
  query.ray.time = 0.0F;
  query.ray.mask = 0xffffffffU;
  query.ray.id = 0;
  query.ray.flags = 0;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(impl_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  Eigen::Vector3f normal(query.hit.Ng_x, query.hit.Ng_y, query.hit.Ng_z);
  const float length = normal.norm();
  // A triangle without area has no normal, so the direction against the ray replaces it.
  normal = length > 0.0F ? Eigen::Vector3f(normal / length) : Eigen::Vector3f(-direction);
  if (normal.dot(direction) > 0.0F) normal = -normal;
  return RayHit{query.ray.tfar, normal};
}

}  // namespace loopwise
