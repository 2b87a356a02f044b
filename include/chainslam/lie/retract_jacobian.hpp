#pragma once

#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// Carries small errors from the tangent space at x to that at y = x.retract(d): to first order in e,
/// x.retract(d + e) = y.retract(retract_jacobian(x, d) * e).
///
/// On a group this is the right Jacobian, whatever x; any other manifold has a member of this name. FAST-LIO2 (Xu et
/// al. 2022, eq. 16) and IKFoM (He et al. 2021, section IV) write its inverse as J.
template <Manifold M>
[[nodiscard]] auto retract_jacobian(const M& x, const typename M::Tangent& d) {
  if constexpr (LieGroup<M>)
    return M::right_jacobian(d);
  else
    return x.retract_jacobian(d);
}

}  // namespace chainslam
