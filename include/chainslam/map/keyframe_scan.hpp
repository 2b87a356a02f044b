#pragma once

#include <concepts>
#include <cstddef>
#include <memory>
#include <mutex>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam {

/// Where scans can be read again, bit for bit: a map's file, for instance. Any number of threads may read at once.
class ScanSource {
 public:
  virtual ~ScanSource() = default;
  /// Scan `number` of this source.
  /// @throws IoError if it cannot be read any more.
  [[nodiscard]] virtual std::shared_ptr<const PointCloud<float>> load(std::size_t number) const = 0;
};

/// A keyframe's scan: kept in memory, or read from where it is stored when it is asked for.
///
/// Copies are the same scan. Its points never change; where they are kept may (`keep_in`), also while other threads
/// read them.
class KeyframeScan {
 public:
  /// The points, for as long as somebody holds them.
  using Cloud = std::shared_ptr<const PointCloud<float>>;

  /// No scan.
  KeyframeScan() = default;
  /// A scan in memory; none if the pointer is null.
  template <std::convertible_to<Cloud> Pointer>
  KeyframeScan(Pointer cloud) {  // NOLINT: clouds are scans
    Cloud points = std::move(cloud);
    if (!points) return;
    const std::size_t size = points->size();
    state_ = std::make_shared<State>(std::move(points), nullptr, std::size_t{0}, size);
  }
  /// Scan `number` of a source, which has `size` points.
  KeyframeScan(std::shared_ptr<const ScanSource> source, std::size_t number, std::size_t size)
      : state_(std::make_shared<State>(nullptr, std::move(source), number, size)) {}

  /// Whether there is a scan.
  explicit operator bool() const { return state_ != nullptr; }
  /// Its points, which are not read for that; 0 without a scan.
  [[nodiscard]] std::size_t size() const { return state_ ? state_->size : 0; }

  /// The points, read from the source if they are not in memory; null without a scan.
  /// @throws IoError if they cannot be read any more.
  [[nodiscard]] Cloud load() const {
    if (!state_) return nullptr;
    const Place place = this->place();
    return place.cloud ? place.cloud : place.source->load(place.number);
  }

  /// Drops this handle's scan.
  void reset() { state_.reset(); }

  /// Where a scan is kept: its points, or the source that has them and its number there.
  struct Place {
    Cloud cloud{};                               ///< null if it is not in memory
    std::shared_ptr<const ScanSource> source{};  ///< null if it is in memory
    std::size_t number = 0;                      ///< in the source
  };
  /// Where it is kept now; all empty without a scan.
  [[nodiscard]] Place place() const {
    if (!state_) return {};
    const std::scoped_lock lock(state_->mutex);
    return {state_->cloud, state_->source, state_->number};
  }

  /// From now on this scan and all copies of it are read from a source that has the same points; the copy in memory
  /// goes when nobody holds it any more.
  void keep_in(std::shared_ptr<const ScanSource> source, std::size_t number) const {
    if (!state_) return;
    Cloud released;  // outside the lock
    const std::scoped_lock lock(state_->mutex);
    released.swap(state_->cloud);
    state_->source = std::move(source);
    state_->number = number;
  }

  /// Whether both are copies of one scan, or both none.
  friend bool operator==(const KeyframeScan&, const KeyframeScan&) = default;

 private:
  struct State {
    State(Cloud points, std::shared_ptr<const ScanSource> from, std::size_t place, std::size_t count)
        : size(count), cloud(std::move(points)), source(std::move(from)), number(place) {}

    const std::size_t size;
    mutable std::mutex mutex;  ///< of all below
    Cloud cloud;
    std::shared_ptr<const ScanSource> source;
    std::size_t number;
  };

  std::shared_ptr<State> state_;
};

}  // namespace chainslam
