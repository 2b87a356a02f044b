#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/factor_places.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/detail/packed_factor.hpp"
#include "chainslam/factor_graph/detail/piece_list.hpp"
#include "chainslam/factor_graph/detail/state_archive.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::detail {

/// What the type of a factor says of all of them.
struct FactorTraits {
  bool holds_in_place = false;
  bool left_invariant = false;
  bool weighable = false;
};

/// A pool of factors on variables of one type, whatever the factors' type.
template <class Group>
class AnyFactorPool : public FactorPlaces {
 public:
  /// Of each factor that is there.
  [[nodiscard]] virtual FactorTraits traits() const = 0;
  /// As `write_linearization`; the factor's weight left out of account.
  virtual void linearize(Index slot, const Values<Group>& values, Kernels kernels, double* numbers) const = 0;
  /// The residual, scaled by the root of the kernel's weight; the factor's weight left out of account.
  virtual void residual(Index slot, const Values<Group>& values, double* residual) const = 0;
  /// The squared residual through the kernel; the factor's weight left out of account.
  [[nodiscard]] virtual double cost(Index slot, const Values<Group>& values) const = 0;
  /// Lets the place of a factor that is not alive be used again.
  virtual void release(Index slot) = 0;

  AnyFactorPool() = default;
  AnyFactorPool(const AnyFactorPool&) = delete;
  AnyFactorPool& operator=(const AnyFactorPool&) = delete;
  virtual ~AnyFactorPool() = default;
};

/// Factors of one type that come and go.
template <Factor F>
class FactorPool final : public AnyFactorPool<typename F::Value> {
  using Group = typename F::Value;
  using Packed = PackedFactor<F>;
  using Shared = typename Packed::Shared;
  using typename FactorPlaces::Place;

 public:
  using Type = F;

  struct Entry {
    decltype(std::declval<const Packed&>().unpacked(std::declval<const Shared&>())) factor;
    double weight;  ///< of its squared residual
    Index term;     ///< its number in the linear system
    bool alive;
  };

  /// @returns the factor's place.
  [[nodiscard]] Index add(const F& factor, Index term) {
    const Index slot = this->take_place(term);
    if (slot == factors_.size()) factors_.add();
    factors_[slot] = Packed(factor, shared_);
    return slot;
  }
  /// To be changed in place; its keys stay. For types that are kept as they are.
  [[nodiscard]] F& factor(Index slot) { return factors_[slot].factor; }
  [[nodiscard]] Entry at(Index slot) const {
    const Place& place = this->place(slot);
    return {factors_[slot].unpacked(shared_), place.weight, place.term, place.alive};
  }

  [[nodiscard]] FactorTraits traits() const override {
    return {holds_in_place<F>, is_left_invariant<F>, is_weighable<F>};
  }
  void linearize(Index slot, const Values<Group>& values, Kernels kernels, double* numbers) const override {
    write_linearization<F>(factors_[slot].unpacked(shared_), values, kernels, numbers);
  }
  void residual(Index slot, const Values<Group>& values, double* residual) const override {
    write_residual<F>(factors_[slot].unpacked(shared_), values, residual);
  }
  [[nodiscard]] double cost(Index slot, const Values<Group>& values) const override {
    return robust_cost<F>(factors_[slot].unpacked(shared_), values);
  }
  void release(Index slot) override {
    this->release_place(slot);
    factors_[slot].give_back(shared_);
  }

  /// visit(entry) for each factor that is there.
  template <class Visit>
  void for_each(Visit&& visit) const {
    for (Index slot = 0; slot < this->places(); ++slot) {
      if (this->place(slot).alive) visit(at(slot));
    }
  }

  /// @param released  places that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const Index> released) const {
    StateWriter write(out);
    out.put(static_cast<std::uint64_t>(factors_.size()));
    for (Index slot = 0; slot < this->places(); ++slot) {
      const Place& place = this->place(slot);
      const auto more = static_cast<Index>(std::count(released.begin(), released.end(), slot));
      out.put(place.alive ? place.term : Index{-1});
      out.put(place.generation + more);
      if (!place.alive) continue;
      out.put(place.weight);
      const F& factor = factors_[slot].unpacked(shared_);
      F::visit_members(factor, write);
    }
    Table<Index> unused = this->free_;
    unused.append(released);
    out.put_list(unused);
  }
  /// What `save` wrote, into an empty pool.
  void load(ByteSource& in) {
    StateReader read(in);
    const auto count = in.take<std::uint64_t>();
    for (std::uint64_t k = 0; k < count; ++k) {
      Place& place = this->places_.add();
      Packed& packed = factors_.add();
      place.term = in.take<Index>();
      place.generation = in.take<Index>();
      place.alive = place.term >= 0;
      if (!place.alive) continue;
      ++this->alive_;
      place.weight = in.take<double>();
      F factor;
      F::visit_members(factor, read);
      packed = Packed(factor, shared_);
    }
    in.take_list(this->free_);
  }

 private:
  PieceList<Packed> factors_;  ///< of each place
  [[no_unique_address]] Shared shared_;
};

/// A pool for each type of factor, and which factor each term of the linear system comes from. A pool is made with the
/// first factor of its type: what is done with factors is then compiled for those types alone that are ever added.
template <Factor First, Factor... Others>
class FactorPools {
  using Group = typename First::Value;

 public:
  struct Place {
    Index type = -1;
    Index slot = -1;
  };

  static constexpr Index types = 1 + static_cast<Index>(sizeof...(Others));
  [[nodiscard]] static std::uint64_t fingerprint() { return detail::fingerprint<First, Others...>(); }

  template <Factor F>
  static constexpr bool has = std::is_same_v<F, First> || (std::is_same_v<F, Others> || ...);

  template <Factor F>
  FactorId add(const F& factor, Index term) {
    if (pools_[type_of<F>()] == nullptr) pools_[type_of<F>()] = std::make_unique<FactorPool<F>>();
    FactorPool<F>& pool = this->pool<F>();
    const Index slot = pool.add(factor, term);
    constexpr auto type = static_cast<Index>(type_of<F>());
    set_place(term, {type, slot});
    return {type, slot, pool.generation(slot)};
  }

  [[nodiscard]] bool contains(const FactorId& id) const {
    return id.type >= 0 && id.type < types && has_pool(id.type) && pool(id.type).contains(id);
  }
  [[nodiscard]] Place place(Index term) const { return of_term_[term]; }

  /// The pool of one type, of which there are factors.
  [[nodiscard]] const AnyFactorPool<Group>& pool(Index type) const { return *pools_[static_cast<std::size_t>(type)]; }
  [[nodiscard]] AnyFactorPool<Group>& pool(Index type) { return *pools_[static_cast<std::size_t>(type)]; }
  template <Factor F>
  [[nodiscard]] FactorPool<F>& pool() {
    return static_cast<FactorPool<F>&>(*pools_[type_of<F>()]);
  }
  template <Factor F>
  [[nodiscard]] const FactorPool<F>& pool() const {
    return static_cast<const FactorPool<F>&>(*pools_[type_of<F>()]);
  }
  /// visit(entry) for each factor, type by type.
  template <class Visit>
  void for_each(Visit&& visit) const {
    visit_pools(*this, [&](const auto& pool) { pool.for_each(visit); });
  }
  /// visit(pool) with each type's pool, if there is one.
  template <class Visit>
  void for_each_pool(Visit&& visit) {
    visit_pools(*this, visit);
  }

  /// The term of each factor, type by type.
  [[nodiscard]] Table<Index> terms() const {
    Table<Index> all;
    all.reserve(count());
    for (const auto& pool : pools_) {
      if (pool == nullptr) continue;
      const FactorPlaces& places = *pool;
      for (Index slot = 0; slot < places.places(); ++slot) {
        if (places.place(slot).alive) all.push_back(places.term(slot));
      }
    }
    return all;
  }

  /// Writes a term's numbers as its factor counts: its kernel applied, scaled by the root of its weight.
  /// @param size  how many they are.
  void linearize(Index term, const Values<Group>& values, double* numbers, Offset size) const {
    const Place at = place(term);
    const AnyFactorPool<Group>& of_type = pool(at.type);
    of_type.linearize(at.slot, values, Kernels::applied, numbers);
    scale(of_type.place(at.slot).weight, numbers, size);
  }
  /// Writes a term's residual alone, likewise.
  void residual(Index term, const Values<Group>& values, double* residual, Offset rows) const {
    const Place at = place(term);
    const AnyFactorPool<Group>& of_type = pool(at.type);
    of_type.residual(at.slot, values, residual);
    scale(of_type.place(at.slot).weight, residual, rows);
  }

  /// Sum of the squared residuals, as the factors count, through their kernels.
  [[nodiscard]] double cost(const Values<Group>& values) const {
    double sum = 0.0;
    for (const auto& pool : pools_) {
      if (pool == nullptr) continue;
      for (Index slot = 0; slot < pool->places(); ++slot) {
        if (pool->place(slot).alive) sum += pool->place(slot).weight * pool->cost(slot, values);
      }
    }
    return sum;
  }

  /// A term's part of that.
  [[nodiscard]] double cost(Index term, const Values<Group>& values) const {
    const Place at = place(term);
    const AnyFactorPool<Group>& of_type = pool(at.type);
    return of_type.place(at.slot).weight * of_type.cost(at.slot, values);
  }

  /// @param released  places of each type that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const std::vector<Index>> released) const {
    save_pool<First>(out, released);
    (save_pool<Others>(out, released), ...);
  }
  void load(ByteSource& in) {
    pools_[0] = std::make_unique<FactorPool<First>>();
    ((pools_[type_of<Others>()] = std::make_unique<FactorPool<Others>>()), ...);
    for_each_pool([&](auto& pool) { pool.load(in); });
    for (Index type = 0; type < types; ++type) {
      const FactorPlaces& places = pool(type);
      for (Index slot = 0; slot < places.places(); ++slot) {
        if (places.place(slot).alive) set_place(places.term(slot), {type, slot});
      }
    }
  }

  template <Factor F>
  [[nodiscard]] Index count() const {
    return has_pool(static_cast<Index>(type_of<F>())) ? pools_[type_of<F>()]->alive() : 0;
  }
  [[nodiscard]] Index count() const {
    Index sum = 0;
    for (const auto& pool : pools_) sum += pool == nullptr ? 0 : pool->alive();
    return sum;
  }

 private:
  static void scale(double weight, double* numbers, Offset size) {
    if (weight == 1.0) return;
    const double root = std::sqrt(weight);
    for (Offset k = 0; k < size; ++k) numbers[k] *= root;
  }
  void set_place(Index term, const Place& place) {
    if (term >= of_term_.size()) of_term_.resize(Offset{term} + 1);
    of_term_[term] = place;
  }
  template <Factor F>
  [[nodiscard]] static constexpr std::size_t type_of() {
    constexpr std::array<bool, types> same{std::is_same_v<F, First>, std::is_same_v<F, Others>...};
    return static_cast<std::size_t>(std::find(same.begin(), same.end(), true) - same.begin());
  }
  [[nodiscard]] bool has_pool(Index type) const { return pools_[static_cast<std::size_t>(type)] != nullptr; }
  template <Factor F>
  void save_pool(ByteSink& out, std::span<const std::vector<Index>> released) const {
    constexpr std::size_t type = type_of<F>();
    if (pools_[type] == nullptr)
      FactorPool<F>().save(out, {});
    else
      pool<F>().save(out, released[type]);
  }
  template <Factor F, class Pools, class Visit>
  static void visit_pool(Pools& pools, Visit&& visit) {
    if (pools.pools_[type_of<F>()] != nullptr) visit(pools.template pool<F>());
  }
  template <class Pools, class Visit>
  static void visit_pools(Pools& pools, Visit&& visit) {
    visit_pool<First>(pools, visit);
    (visit_pool<Others>(pools, visit), ...);
  }

  std::array<std::unique_ptr<AnyFactorPool<Group>>, types> pools_;
  Table<Place> of_term_;
};

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

}  // namespace chainslam::detail
