#pragma once

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/piece_list.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::detail {

/// Which places of a pool are taken, and by what. Places are used again, with another generation.
class FactorPlaces {
 public:
  struct Place {
    double weight = 1.0;  ///< of the factor's squared residual
    Index term = -1;      ///< the factor's number in the linear system
    Index generation = 0;
    bool alive = false;
  };

  void set_alive(Index slot, bool alive) {
    at_place(slot).alive = alive;
    alive_ += alive ? 1 : -1;
  }
  void set_weight(Index slot, double weight) { at_place(slot).weight = weight; }
  [[nodiscard]] const Place& place(Index slot) const { return places_[slot]; }
  [[nodiscard]] Index term(Index slot) const { return place(slot).term; }
  [[nodiscard]] Index generation(Index slot) const { return place(slot).generation; }
  /// Places, be they taken or not.
  [[nodiscard]] Index places() const { return places_.size(); }
  [[nodiscard]] Index alive() const { return alive_; }
  [[nodiscard]] bool contains(const FactorId& id) const {
    return id.slot >= 0 && id.slot < places() && place(id.slot).alive && generation(id.slot) == id.generation;
  }

 protected:
  /// A place for a factor that is there from now on.
  [[nodiscard]] Index take_place(Index term) {
    ++alive_;
    Index slot = places();
    if (free_.empty()) {
      places_.add();
    } else {
      slot = free_.back();
      free_.pop_back();
    }
    at_place(slot) = {1.0, term, generation(slot), true};
    return slot;
  }
  void release_place(Index slot) {
    ++at_place(slot).generation;
    free_.push_back(slot);
  }
  [[nodiscard]] Place& at_place(Index slot) { return places_[slot]; }

  PieceList<Place> places_;
  Table<Index> free_;
  Index alive_ = 0;
};

}  // namespace chainslam::detail
