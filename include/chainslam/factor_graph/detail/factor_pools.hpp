#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <deque>
#include <span>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/detail/packed_factor.hpp"
#include "chainslam/factor_graph/detail/state_archive.hpp"

namespace chainslam {

/// Names a factor of an `IncrementalSmoother` for as long as it is there, and never another one after it.
struct FactorId {
  Index type = -1;  ///< which of the smoother's types of factors
  Index slot = -1;
  Index generation = -1;

  friend bool operator==(const FactorId&, const FactorId&) = default;
};

}  // namespace chainslam

namespace chainslam::detail {

/// Factors of one type that come and go. Places are used again, with another generation.
template <Factor F>
class FactorPool {
  using Packed = PackedFactor<F>;
  using Shared = typename Packed::Shared;

  struct Place {
    Packed packed{};
    double weight = 1.0;
    Index term = -1;
    Index generation = 0;
    bool alive = false;
  };

 public:
  using Type = F;

  struct Entry {
    decltype(std::declval<const Packed&>().unpacked(std::declval<const Shared&>())) factor;
    double weight;  ///< of its squared residual
    Index term;     ///< its number in the linear system
    Index generation;
    bool alive;
  };

  /// @returns the factor's place.
  [[nodiscard]] Index add(const F& factor, Index term) {
    ++alive_;
    Index slot = to_index(places_.size());
    if (free_.empty()) {
      places_.emplace_back();
    } else {
      slot = free_.back();
      free_.pop_back();
    }
    Place& place = at_place(slot);
    place = {Packed(factor, shared_), 1.0, term, place.generation, true};
    return slot;
  }
  void set_alive(Index slot, bool alive) {
    at_place(slot).alive = alive;
    alive_ += alive ? 1 : -1;
  }
  /// To be changed in place; its keys stay. For types that are kept as they are.
  [[nodiscard]] F& factor(Index slot) { return at_place(slot).packed.factor; }
  void set_weight(Index slot, double weight) { at_place(slot).weight = weight; }
  /// Lets the place of a factor that is not alive be used again.
  void release(Index slot) {
    ++at_place(slot).generation;
    at_place(slot).packed.give_back(shared_);
    free_.push_back(slot);
  }
  [[nodiscard]] Entry at(Index slot) const { return entry(places_[static_cast<std::size_t>(slot)]); }
  [[nodiscard]] Index term(Index slot) const { return places_[static_cast<std::size_t>(slot)].term; }
  [[nodiscard]] Index generation(Index slot) const { return places_[static_cast<std::size_t>(slot)].generation; }
  [[nodiscard]] Index alive() const { return alive_; }
  [[nodiscard]] bool contains(const FactorId& id) const {
    return id.slot >= 0 && id.slot < to_index(places_.size()) && places_[static_cast<std::size_t>(id.slot)].alive &&
           generation(id.slot) == id.generation;
  }

  /// visit(entry) for each factor that is there.
  template <class Visit>
  void for_each(Visit&& visit) const {
    for (const Place& place : places_) {
      if (place.alive) visit(entry(place));
    }
  }

  /// visit(place, term) for each factor that is there.
  template <class Visit>
  void for_each_slot(Visit&& visit) const {
    Index slot = 0;
    for (const Place& place : places_) {
      if (place.alive) visit(slot, place.term);
      ++slot;
    }
  }

  /// @param released  places that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const Index> released) const {
    StateWriter write(out);
    out.put(static_cast<std::uint64_t>(places_.size()));
    Index slot = 0;
    for (const Place& place : places_) {
      const auto more = static_cast<Index>(std::count(released.begin(), released.end(), slot++));
      out.put(place.alive ? place.term : Index{-1});
      out.put(place.generation + more);
      if (!place.alive) continue;
      out.put(place.weight);
      const F& factor = place.packed.unpacked(shared_);
      F::visit_members(factor, write);
    }
    std::vector<Index> unused = free_;
    unused.insert(unused.end(), released.begin(), released.end());
    out.put_list(unused);
  }
  /// What `save` wrote, into an empty pool.
  void load(ByteSource& in) {
    StateReader read(in);
    places_.resize(in.take<std::uint64_t>());
    for (Place& place : places_) {
      place.term = in.take<Index>();
      place.generation = in.take<Index>();
      place.alive = place.term >= 0;
      if (!place.alive) continue;
      ++alive_;
      place.weight = in.take<double>();
      F factor;
      F::visit_members(factor, read);
      place.packed = Packed(factor, shared_);
    }
    in.take_list(free_);
  }

 private:
  [[nodiscard]] Place& at_place(Index slot) { return places_[static_cast<std::size_t>(slot)]; }
  [[nodiscard]] Entry entry(const Place& place) const {
    return {place.packed.unpacked(shared_), place.weight, place.term, place.generation, place.alive};
  }

  std::deque<Place> places_;  ///< grows without a copy, in time and in memory
  [[no_unique_address]] Shared shared_;
  std::vector<Index> free_;
  Index alive_ = 0;
};

/// A pool for each type of factor, and which factor each term of the linear system comes from.
template <Factor... Factors>
class FactorPools {
 public:
  struct Place {
    Index type = -1;
    Index slot = -1;
  };

  static constexpr std::size_t types = sizeof...(Factors);
  [[nodiscard]] static std::uint64_t fingerprint() { return detail::fingerprint<Factors...>(); }

  template <Factor F>
  static constexpr bool has = (std::is_same_v<F, Factors> || ...);

  template <Factor F>
  FactorId add(const F& factor, Index term) {
    auto& pool = std::get<FactorPool<F>>(pools_);
    const Index slot = pool.add(factor, term);
    set_place(term, {type_of<F>(), slot});
    return {type_of<F>(), slot, pool.generation(slot)};
  }

  [[nodiscard]] bool contains(const FactorId& id) const {
    bool found = false;
    visit_pool(id.type, [&](const auto& pool) { found = pool.contains(id); });
    return found;
  }
  [[nodiscard]] Place place(Index term) const { return of_term_[static_cast<std::size_t>(term)]; }

  /// visit(pool) with the pool of one type.
  template <class Visit>
  void visit_pool(Index type, Visit&& visit) {
    Index k = 0;
    std::apply([&](auto&... pools) { ((k++ == type ? visit(pools) : void()), ...); }, pools_);
  }
  template <class Visit>
  void visit_pool(Index type, Visit&& visit) const {
    Index k = 0;
    std::apply([&](const auto&... pools) { ((k++ == type ? visit(pools) : void()), ...); }, pools_);
  }
  /// visit(entry) with the factor of a term.
  template <class Visit>
  void visit_term(Index term, Visit&& visit) const {
    const Place at = place(term);
    visit_pool(at.type, [&](const auto& pool) { visit(pool.at(at.slot)); });
  }
  /// visit(entry) for each factor, type by type.
  template <class Visit>
  void for_each(Visit&& visit) const {
    std::apply([&](const auto&... pools) { (pools.for_each(visit), ...); }, pools_);
  }

  /// @param released  places of each type that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const std::vector<Index>> released) const {
    std::size_t type = 0;
    std::apply([&](const auto&... pools) { (pools.save(out, released[type++]), ...); }, pools_);
  }
  void load(ByteSource& in) {
    Index type = 0;
    std::apply([&](auto&... pools) { (load_pool(pools, type++, in), ...); }, pools_);
  }

  template <Factor F>
  [[nodiscard]] FactorPool<F>& pool() {
    return std::get<FactorPool<F>>(pools_);
  }
  template <Factor F>
  [[nodiscard]] Index count() const {
    return std::get<FactorPool<F>>(pools_).alive();
  }
  [[nodiscard]] Index count() const {
    return std::apply([](const auto&... pools) { return (pools.alive() + ...); }, pools_);
  }

 private:
  void set_place(Index term, const Place& place) {
    if (term >= to_index(of_term_.size())) of_term_.resize(static_cast<std::size_t>(term) + 1);
    of_term_[static_cast<std::size_t>(term)] = place;
  }
  template <class Pool>
  void load_pool(Pool& pool, Index type, ByteSource& in) {
    pool.load(in);
    pool.for_each_slot([&](Index slot, Index term) { set_place(term, {type, slot}); });
  }
  template <Factor F>
  [[nodiscard]] static constexpr Index type_of() {
    constexpr std::array<bool, sizeof...(Factors)> same{std::is_same_v<F, Factors>...};
    return static_cast<Index>(std::find(same.begin(), same.end(), true) - same.begin());
  }

  std::tuple<FactorPool<Factors>...> pools_;
  std::vector<Place> of_term_;
};

/// Whether a motion of all its variables from the left changes nothing for a factor, as its member says.
template <class F>
inline constexpr bool is_left_invariant = [] {
  if constexpr (requires { F::left_invariant; }) return static_cast<bool>(F::left_invariant);
  return false;
}();

/// Whether a factor's weight can be set: its kernel, if it has one, does not, nor has it parts that are not scaled.
template <class F>
inline constexpr bool is_weighable = [] {
  if constexpr (F::arity == std::dynamic_extent || !requires(F & factor) { factor.sqrt_information *= 1.0; })
    return false;
  else if constexpr (requires(const F& factor) { factor.kernel; })
    return std::is_same_v<std::remove_cvref_t<decltype(std::declval<const F&>().kernel)>, Trivial>;
  return true;
}();

/// Names variables that many places later.
template <class F>
void shift_keys(F& factor, Index places) {
  const auto shift = [&](auto& member) {
    using Member = std::remove_cvref_t<decltype(member)>;
    if constexpr (std::is_same_v<Member, Key>) member += places;
    if constexpr (std::is_same_v<Member, std::vector<Key>>) {
      for (Key& key : member) key += places;
    }
  };
  F::visit_members(factor, [&](auto&... members) { (shift(members), ...); });
}

/// visit(factor) with the factor as it counts: its square root of information scaled by the root of its weight.
template <class Entry, class Visit>
decltype(auto) visit_weighed(const Entry& entry, Visit&& visit) {
  using F = std::remove_cvref_t<decltype(entry.factor)>;
  if constexpr (is_weighable<F>) {
    if (entry.weight != 1.0) {
      F weighed = entry.factor;
      weighed.sqrt_information *= std::sqrt(entry.weight);
      return visit(std::as_const(weighed));
    }
  }
  return visit(entry.factor);
}

/// A factor's residual and Jacobians, scaled by the root of its kernel's weight.
template <Factor F>
[[nodiscard]] auto weighted_linearization(const F& factor, const Values<typename F::Value>& values) {
  auto result = factor.linearize(values);
  if constexpr (RobustFactor<F>) {
    const double scale = std::sqrt(factor.kernel.weight(result.residual.squaredNorm()));
    result.residual *= scale;
    for (auto& jacobian : result.jacobians) jacobian *= scale;
  }
  return result;
}

/// A factor's residual, scaled by the root of its kernel's weight.
template <Factor F>
[[nodiscard]] Eigen::Matrix<double, F::rows, 1> weighted_residual(const F& factor,
                                                                  const Values<typename F::Value>& values) {
  Eigen::Matrix<double, F::rows, 1> residual = factor.residual(values);
  if constexpr (RobustFactor<F>) residual *= std::sqrt(factor.kernel.weight(residual.squaredNorm()));
  return residual;
}

template <Factor F>
[[nodiscard]] double robust_cost(const F& factor, const Values<typename F::Value>& values) {
  const double squared = factor.residual(values).squaredNorm();
  if constexpr (RobustFactor<F>) return factor.kernel.cost(squared);
  return squared;
}

}  // namespace chainslam::detail
