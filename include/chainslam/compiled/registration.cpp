#include "chainslam/registration/align.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {

template AlignResult Icp<PointToPlane, GemanMcClure>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                            const SE3d&, const Serial&, const Deadline&) const;
template AlignResult Icp<PointToPlane, GemanMcClure>::align(const PointCloud<float>&, const IndexedCloud<>&,
                                                            const SE3d&, const ThreadPool&, const Deadline&) const;
template AlignResult Icp<PointToPlane, Huber>::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                     const Serial&, const Deadline&) const;
template AlignResult Icp<PointToPlane, Huber>::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                                     const ThreadPool&, const Deadline&) const;
template AlignResult PointToPlaneIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&, const Serial&,
                                            const Deadline&) const;
template AlignResult PointToPlaneIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                            const ThreadPool&, const Deadline&) const;
template AlignResult PointToPointIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&, const Serial&,
                                            const Deadline&) const;
template AlignResult PointToPointIcp::align(const PointCloud<float>&, const IndexedCloud<>&, const SE3d&,
                                            const ThreadPool&, const Deadline&) const;

template GlobalAlignResult FeatureRegistration<>::align(const PointCloud<float>&, const PointCloud<float>&,
                                                        const Serial&, const Deadline&) const;
template GlobalAlignResult FeatureRegistration<>::align(const PointCloud<float>&, const PointCloud<float>&,
                                                        const ThreadPool&, const Deadline&) const;

template NormalEstimates estimate_normals(PointCloud<float>&, const NormalOptions&, const Eigen::Vector3d&,
                                          const Serial&);
template NormalEstimates estimate_normals(PointCloud<float>&, const NormalOptions&, const Eigen::Vector3d&,
                                          const ThreadPool&);

}  // namespace chainslam
