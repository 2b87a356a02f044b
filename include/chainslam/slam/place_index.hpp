#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <numbers>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/height_image.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/registration/consistency_graph.hpp"
#include "chainslam/search/hamming_forest.hpp"

namespace chainslam {

/// How places are found by their keypoints.
struct PlaceIndexOptions {
  HammingForestOptions forest{};       ///< the index of descriptors
  Index max_distance = 70;             ///< bits, of 256, between the descriptors of a match
  Index vote_distance = 55;            ///< bits: more similar ones vote for a place
  Index shortlist = 12;                ///< places with most similar descriptors, whose keypoints are matched one by one
  Index min_inliers = 6;               ///< matches that agree on one motion
  PlanarConsensusOptions consensus{};  ///< when matches agree on a motion
};

/// A place that looks like the query.
struct PlaceMatch {
  Index place = 0;     ///< its number
  SE2d T_place_query;  ///< between the frames of the images, seen from above
  Index inliers = 0;   ///< matches that agree on the motion
};

/// Finds places by the corners of their height images.
///
/// A forest of descriptors gives a shortlist of places; each keypoint of those is matched with the query's, and places
/// are ranked by how many matches agree on one motion of the plane. A query takes time logarithmic in the number of
/// places.
class PlaceIndex {
 public:
  /// @throws std::invalid_argument if an option makes no sense.
  explicit PlaceIndex(const PlaceIndexOptions& options = {}) : options_(options), forest_(options.forest) {
    if (options.max_distance < 0 || options.vote_distance < 0 || options.shortlist < 1 || options.min_inliers < 3)
      throw std::invalid_argument(
          "PlaceIndex: max_distance and vote_distance must not be negative, shortlist at least 1, min_inliers at least "
          "3");
  }

  /// Adds a place. @returns its number: they are counted from 0.
  Index add(std::span<const ImageKeypoint> keypoints) {
    const Index place = to_index(ends_.size(), "number of places");
    for (const ImageKeypoint& keypoint : keypoints) {
      forest_.insert(keypoint.descriptor);
      keypoints_.push_back({keypoint.position.x(), keypoint.position.y(), keypoint.angle});
    }
    ends_.push_back(to_index(forest_.size(), "number of keypoints"));
    return place;
  }

  [[nodiscard]] std::size_t size() const { return ends_.size(); }              ///< number of places
  [[nodiscard]] const PlaceIndexOptions& options() const { return options_; }  ///< its settings

  /// Places that look like the query, those with most inliers first, equal ones by number.
  /// @param wanted  which places to look at: those that it is true for.
  template <std::predicate<Index> Wanted>
  [[nodiscard]] std::vector<PlaceMatch> find(std::span<const ImageKeypoint> query, Wanted&& wanted) const {
    std::vector<PlaceMatch> found;
    for (const Index place : shortlist(query, wanted)) {
      const PlaceMatch match = compare(query, place);
      if (match.inliers >= options_.min_inliers) found.push_back(match);
    }
    std::sort(found.begin(), found.end(), [](const PlaceMatch& a, const PlaceMatch& b) {
      return a.inliers != b.inliers ? a.inliers > b.inliers : a.place < b.place;
    });
    return found;
  }
  /// Places that look like the query, those with most inliers first.
  [[nodiscard]] std::vector<PlaceMatch> find(std::span<const ImageKeypoint> query) const {
    return find(query, [](Index) { return true; });
  }

  /// The motion that most matches between the query and one place agree on.
  [[nodiscard]] PlaceMatch compare(std::span<const ImageKeypoint> query, Index place) const {
    detail::Table<PlanarMatch> matches;
    for (const Pair& pair : mutual(query, place)) {
      const ImageKeypoint& a = query[static_cast<std::size_t>(pair.query)];
      const Stored& b = keypoints_[pair.id];
      matches.push_back({a.position.cast<double>(), b.position().cast<double>(),
                         static_cast<double>(b.angle) - static_cast<double>(a.angle)});
    }
    const PlanarConsensus consensus = planar_consensus(matches.all(), options_.consensus);
    return {.place = place, .T_place_query = consensus.T_target_source, .inliers = consensus.inliers};
  }

 private:
  /// A keypoint of a place. The forest has its descriptor.
  struct Stored {
    float x = 0, y = 0, angle = 0;
    [[nodiscard]] Eigen::Vector2f position() const { return {x, y}; }
  };
  struct Pair {
    Index query = 0;
    Index id = 0;
  };
  /// A stored keypoint that is similar to one of the query's.
  struct Hit {
    Index place = 0;
    Index query = 0;
    Index id = 0;
    double weight = 0;
  };

  [[nodiscard]] Index begin(Index place) const { return place == 0 ? 0 : ends_[static_cast<std::size_t>(place - 1)]; }
  [[nodiscard]] Index end(Index place) const { return ends_[static_cast<std::size_t>(place)]; }
  [[nodiscard]] Index place_of(Index id) const {
    return static_cast<Index>(std::upper_bound(ends_.begin(), ends_.end(), id) - ends_.begin());
  }

  /// Places by the weight of the similar keypoints that agree in pairs: they lie as far apart here and there, and are
  /// turned by the same angle.
  template <class Wanted>
  [[nodiscard]] detail::Table<Index> shortlist(std::span<const ImageKeypoint> query, const Wanted& wanted) const {
    std::vector<Hit> hits = this->hits(query);
    std::sort(hits.begin(), hits.end(), [](const Hit& a, const Hit& b) {
      return a.place != b.place ? a.place < b.place : a.query != b.query ? a.query < b.query : a.id < b.id;
    });
    detail::Table<Ranked> ranked;
    for (std::size_t begin = 0, end = 0; begin < hits.size(); begin = end) {
      const Index place = hits[begin].place;
      while (end < hits.size() && hits[end].place == place) ++end;
      const double votes = agreeing_weight(query, std::span(hits).subspan(begin, end - begin));
      if (votes > 0 && wanted(place)) ranked.push_back({-votes, place});
    }
    sort_ranked(ranked.all());
    detail::Table<Index> best;
    for (const Ranked& one : ranked)
      if (best.size() < options_.shortlist) best.push_back(one.index);
    return best;
  }

  [[nodiscard]] std::vector<Hit> hits(std::span<const ImageKeypoint> query) const {
    detail::Table<BinaryDescriptor> descriptors;
    for (const ImageKeypoint& keypoint : query) descriptors.push_back(keypoint.descriptor);
    std::vector<HammingForest::Found> near;
    forest_.near_each(descriptors.all(), options_.vote_distance, near);
    std::vector<Hit> hits;
    for (std::size_t begin = 0, end = 0; begin < near.size(); begin = end) {
      while (end < near.size() && near[end].query == near[begin].query) ++end;
      const double weight = 1.0 / std::sqrt(static_cast<double>(end - begin));  // what is common says little
      for (std::size_t i = begin; i < end; ++i)
        hits.push_back({place_of(near[i].id), near[i].query, near[i].id, weight});
    }
    return hits;
  }

  /// The largest weight of hits of one place that agree with one of them.
  [[nodiscard]] double agreeing_weight(std::span<const ImageKeypoint> query, std::span<const Hit> hits) const {
    const auto here = [&](const Hit& hit) -> const ImageKeypoint& {
      return query[static_cast<std::size_t>(hit.query)];
    };
    const auto there = [&](const Hit& hit) -> const Stored& { return keypoints_[hit.id]; };
    const auto allowed = static_cast<float>(options_.consensus.max_distance);
    const auto max_angle = static_cast<float>(options_.consensus.max_angle);
    const auto agree = [&](const Hit& a, const Hit& b) {
      if (a.query == b.query || a.id == b.id) return false;
      const float apart = (here(a).position - here(b).position).norm();
      if (std::abs(apart - (there(a).position() - there(b).position()).norm()) > allowed) return false;
      const float turned = (there(a).angle - here(a).angle) - (there(b).angle - here(b).angle);
      return std::abs(std::remainder(turned, 2 * std::numbers::pi_v<float>)) <= max_angle;
    };
    detail::Table<double> weights(static_cast<Offset>(hits.size()), 0.0);  // of what agrees with each
    double most = 0;
    for (std::size_t a = 0; a < hits.size(); ++a) {
      double& weight = weights[static_cast<Offset>(a)];
      for (std::size_t b = a + 1; b < hits.size(); ++b) {
        if (!agree(hits[a], hits[b])) continue;
        weight += hits[b].weight;
        weights[static_cast<Offset>(b)] += hits[a].weight;
      }
      most = std::max(most, weight > 0 ? weight + hits[a].weight : 0.0);
    }
    return most;
  }

  /// Keypoints that are each other's most similar one.
  [[nodiscard]] detail::Table<Pair> mutual(std::span<const ImageKeypoint> query, Index place) const {
    struct Nearest {
      Index distance;
      Index index = -1;
    };
    const Index first = begin(place), count = end(place) - first;
    detail::Table<Nearest> of_query(static_cast<Offset>(query.size()), {options_.max_distance + 1});
    detail::Table<Nearest> of_place(count, {options_.max_distance + 1});
    for (Index i = 0; i < static_cast<Index>(query.size()); ++i)
      for (Index j = 0; j < count; ++j) {
        const Index distance = hamming_distance_within(query[static_cast<std::size_t>(i)].descriptor,
                                                       forest_.descriptor(first + j), options_.max_distance);
        if (distance < of_query[i].distance) of_query[i] = {distance, j};
        if (distance < of_place[j].distance) of_place[j] = {distance, i};
      }
    detail::Table<Pair> pairs;
    for (Index i = 0; i < static_cast<Index>(query.size()); ++i)
      if (const Index j = of_query[i].index; j >= 0 && of_place[j].index == i) pairs.push_back({i, first + j});
    return pairs;
  }

  PlaceIndexOptions options_;
  HammingForest forest_;
  detail::Table<Stored> keypoints_;  ///< place by place; numbered as the forest's descriptors
  std::vector<Index> ends_;          ///< of each place's keypoints
};

}  // namespace chainslam
