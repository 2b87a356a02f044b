#pragma once

#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// The point at `t` on the geodesic from `a` (t = 0, exactly) to `b` (t = 1, exactly); other t extrapolate.
///
/// On SE(3) this is the screw motion with constant body velocity; on SO(3) it is slerp by the shorter way.
template <Manifold M>
[[nodiscard]] M interpolate(const M& a, const M& b, typename M::Scalar t) {
  using Scalar = typename M::Scalar;
  if (t == Scalar(0)) return a;
  if (t == Scalar(1)) return b;
  return a.retract(t * a.local(b));
}

}  // namespace chainslam
