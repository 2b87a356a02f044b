#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <tuple>
#include <utility>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/jacobians.hpp"

namespace chainslam {

/// Several manifolds side by side, tangents stacked in order; a `LieGroup` if all parts are.
///
/// A filter's state, for example: Product<SO3d, R3d, R3d, S2d>. All parts have the same scalar.
template <Manifold First, Manifold... Rest>
class Product {
  static constexpr bool is_group = LieGroup<First> && (LieGroup<Rest> && ...);

 public:
  using Scalar = typename First::Scalar;  ///< float, double or an autodiff number
  static_assert((std::same_as<Scalar, typename Rest::Scalar> && ...), "Product: all parts need the same Scalar");

  static constexpr std::size_t size = 1 + sizeof...(Rest);    ///< number of parts
  static constexpr int dof = (First::dof + ... + Rest::dof);  ///< dimension of the tangent space
  using Tangent = Eigen::Matrix<Scalar, dof, 1>;              ///< element of the tangent space
  using Jacobian = Eigen::Matrix<Scalar, dof, dof>;           ///< derivative of one tangent by another
  template <std::size_t I>
  using Part = std::tuple_element_t<I, std::tuple<First, Rest...>>;  ///< type of part I

  Product() = default;
  explicit Product(const First& first, const Rest&... rest) : parts_(first, rest...) {}  ///< of its parts

  /// Part I.
  template <std::size_t I>
  [[nodiscard]] const Part<I>& get() const {
    return std::get<I>(parts_);
  }
  /// Part I.
  template <std::size_t I>
  [[nodiscard]] Part<I>& get() {
    return std::get<I>(parts_);
  }

  /// Where the tangent of part I starts.
  template <std::size_t I>
  [[nodiscard]] static constexpr int offset() {
    constexpr std::array<int, size> sizes{First::dof, Rest::dof...};
    int sum = 0;
    for (std::size_t i = 0; i < I; ++i) sum += sizes[i];
    return sum;
  }
  /// The rows of a tangent that belong to part I.
  template <std::size_t I>
  [[nodiscard]] static typename Part<I>::Tangent segment(const Tangent& d) {
    return block_of<Part<I>::dof, 1>(d, offset<I>(), 0);
  }

  /// The point reached from here along a tangent.
  [[nodiscard]] Product retract(const Tangent& d) const {
    return generate([&]<std::size_t I>() { return get<I>().retract(segment<I>(d)); });
  }
  /// The tangent with retract(local(other)) == other.
  [[nodiscard]] Tangent local(const Product& other) const {
    return stack([&]<std::size_t I>() { return get<I>().local(other.template get<I>()); });
  }

  /// d retract(d).local(retract(d + e)) / d e at e = 0: see `lie/jacobians.hpp`.
  [[nodiscard]] Jacobian retract_jacobian(const Tangent& d) const {
    return block_diagonal([&]<std::size_t I>() { return chainslam::retract_jacobian(get<I>(), segment<I>(d)); });
  }

  [[nodiscard]] static Product identity() requires(is_group) { return Product(); }  ///< the neutral element
  /// The group element of a tangent; see the class for the order of its coordinates.
  [[nodiscard]] static Product exp(const Tangent& d) requires(is_group) {
    return generate([&]<std::size_t I>() { return Part<I>::exp(segment<I>(d)); });
  }
  /// The tangent with exp(log()) == *this.
  [[nodiscard]] Tangent log() const requires(is_group) {
    return stack([&]<std::size_t I>() { return get<I>().log(); });
  }
  /// X * x.inverse() is the identity.
  [[nodiscard]] Product inverse() const requires(is_group) {
    return generate([&]<std::size_t I>() { return get<I>().inverse(); });
  }
  /// Part by part.
  [[nodiscard]] Product operator*(const Product& other) const requires(is_group) {
    return generate([&]<std::size_t I>() { return get<I>() * other.template get<I>(); });
  }
  /// X exp(d) x^-1 = exp(adjoint() d).
  [[nodiscard]] Jacobian adjoint() const requires(is_group) {
    return block_diagonal([&]<std::size_t I>() { return get<I>().adjoint(); });
  }
  /// Exp(v + d) = exp(left_jacobian(v) d) exp(v) to first order.
  [[nodiscard]] static Jacobian left_jacobian(const Tangent& d) requires(is_group) {
    return block_diagonal([&]<std::size_t I>() { return Part<I>::left_jacobian(segment<I>(d)); });
  }
  /// Inverse of `left_jacobian`.
  [[nodiscard]] static Jacobian left_jacobian_inverse(const Tangent& d) requires(is_group) {
    return block_diagonal([&]<std::size_t I>() { return Part<I>::left_jacobian_inverse(segment<I>(d)); });
  }
  /// Exp(v + d) = exp(v) exp(right_jacobian(v) d) to first order.
  [[nodiscard]] static Jacobian right_jacobian(const Tangent& d) requires(is_group) { return left_jacobian(-d); }
  /// Inverse of `right_jacobian`.
  [[nodiscard]] static Jacobian right_jacobian_inverse(const Tangent& d) requires(is_group) {
    return left_jacobian_inverse(-d);
  }

  /// Whether all members are equal.
  friend bool operator==(const Product& a, const Product& b) { return a.parts_ == b.parts_; }

 private:
  /// Calls body<I>() for each part in order.
  template <class Body>
  static void for_each_part(Body&& body) {
    [&]<std::size_t... I>(std::index_sequence<I...>) { (body.template operator()<I>(), ...); }
    (std::make_index_sequence<size>{});
  }
  template <class Value>
  [[nodiscard]] static Product generate(Value&& value) {
    Product result;
    for_each_part([&]<std::size_t I>() { result.template get<I>() = value.template operator()<I>(); });
    return result;
  }
  template <class Value>
  [[nodiscard]] static Tangent stack(Value&& value) {
    Tangent d;
    for_each_part([&]<std::size_t I>() {
      set_block(d, offset<I>(), 0, typename Part<I>::Tangent(value.template operator()<I>()));
    });
    return d;
  }
  template <class Value>
  [[nodiscard]] static Jacobian block_diagonal(Value&& value) {
    Jacobian matrix = zeros<Jacobian>();
    for_each_part(
        [&]<std::size_t I>() { set_block(matrix, offset<I>(), offset<I>(), value.template operator()<I>()); });
    return matrix;
  }

  std::tuple<First, Rest...> parts_;
};

}  // namespace chainslam
