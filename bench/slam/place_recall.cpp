// How many submaps of a session are recognized in another one, and how many wrongly, as a Markdown table: see
// bench/README.md.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/slam/place_candidates.hpp"
#include "keyframe_sets.hpp"
#include "slam/place_recall/submaps.hpp"
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
#include "slam/peers/map_closures.hpp"
#endif

namespace chainslam::bench {
namespace {

struct Options {
  std::vector<std::filesystem::path> sessions;
  SubmapCut cut{};
  PlaceCandidateOptions places{};
  double tolerance = 2.0;           // metres
  double tolerance_deg = 5.0;       // degrees
  double heading = 0.6;             // radians by which each session's odometry is turned against the one before
  double peer_cell_size = 0.5;      // metres
  Index peer_inliers = 5;           // as MapClosures' own pipeline asks for
  std::filesystem::path transform;  // T_first_second of two sessions whose truth is not in one frame
};

struct Session {
  std::vector<Submap> submaps;
  std::vector<std::vector<ImageKeypoint>> keypoints;
};

SE3d read_transform(const std::filesystem::path& path) {
  std::ifstream file(path);
  Eigen::Matrix4d T;
  for (int k = 0; k < 16; ++k)
    if (!(file >> T(k / 4, k % 4))) throw std::runtime_error(path.string() + ": not 16 numbers, row by row");
  return SE3d::from_matrix(T);
}

Trajectory truth_of(const lamm::KeyframeSet& set, const Options& options, bool is_first) {
  if (options.transform.empty()) {
    if (!set.truth) throw std::runtime_error(set.drive.name + ": no ground truth; see --transform");
    return *set.truth;
  }
  const SE3d T_first_odom = is_first ? SE3d() : read_transform(options.transform);
  Trajectory truth;
  for (const Keyframe& keyframe : set.keyframes) {
    truth.times.push_back(keyframe.time);
    truth.poses.push_back(T_first_odom * keyframe.T_odom_body);
  }
  return truth;
}

Session read_session(const std::filesystem::path& folder, const Options& options, std::size_t number) {
  const lamm::KeyframeSet set = lamm::read_keyframe_set(folder);
  SubmapCut cut = options.cut;
  cut.heading = options.heading * static_cast<double>(number);
  Session session{.submaps = submaps_of(set.keyframes, truth_of(set, options, number == 0), cut), .keypoints = {}};
  for (const Submap& submap : session.submaps)
    session.keypoints.push_back(
        image_keypoints(height_image(submap.cloud, options.places.image), options.places.keypoints));
  return session;
}

/// What a recognizer makes of all queries.
class Recall {
 public:
  void add(const std::optional<PlaceMatch>& match, const SE3d& T_place_query, const Options& options) {
    if (!match) return;
    const Eigen::Matrix3d R = T_place_query.rotation().matrix();
    const double turn =
        std::remainder(std::atan2(R(1, 0), R(0, 0)) - match->T_place_query.rotation().angle(), 2 * std::numbers::pi);
    const double off = (T_place_query.translation().head<2>() - match->T_place_query.translation()).norm();
    const bool right = off < options.tolerance && std::abs(turn) < options.tolerance_deg * std::numbers::pi / 180;
    (right ? right_ : wrong_).push_back(match->inliers);
  }
  void add_time(double seconds) { seconds_ += seconds, ++queries_; }

  /// Right ones with more inliers than any wrong one.
  [[nodiscard]] std::ptrdiff_t at_full_precision() const {
    const Index worst = wrong_.empty() ? 0 : *std::max_element(wrong_.begin(), wrong_.end());
    return std::count_if(right_.begin(), right_.end(), [&](Index inliers) { return inliers > worst; });
  }
  [[nodiscard]] std::ptrdiff_t right(Index least) const { return at_least(right_, least); }
  [[nodiscard]] std::ptrdiff_t wrong(Index least) const { return at_least(wrong_, least); }
  [[nodiscard]] double milliseconds() const { return queries_ > 0 ? 1e3 * seconds_ / queries_ : 0; }

 private:
  [[nodiscard]] static std::ptrdiff_t at_least(const std::vector<Index>& inliers, Index least) {
    return std::count_if(inliers.begin(), inliers.end(), [&](Index one) { return one >= least; });
  }
  std::vector<Index> right_, wrong_;
  double seconds_ = 0;
  int queries_ = 0;
};

template <class Find>
std::optional<PlaceMatch> timed(Recall& recall, const Find& find) {
  const auto begin = std::chrono::steady_clock::now();
  const std::optional<PlaceMatch> match = find();
  recall.add_time(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  return match;
}

void print(const char* name, const Recall& recall, Index least, std::ptrdiff_t queries) {
  const double share = queries > 0 ? 100.0 * static_cast<double>(recall.at_full_precision()) / static_cast<double>(queries) : 0;
  std::printf("| %s | %td (%.0f %%) | %td, %td | %.1f ms ", name, recall.at_full_precision(), share,
              recall.right(least), recall.wrong(least), recall.milliseconds());
}

void compare(const Session& places, const Session& queries, const Options& options) {
  PlaceIndexOptions index_options = options.places.index;
  index_options.min_inliers = 3;  // all that it finds; what counts is decided below
  PlaceIndex index(index_options);
  for (const auto& keypoints : places.keypoints) index.add(keypoints);
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  MapClosuresPlaces peer(options.peer_cell_size);
  Recall of_peer;
  for (const Submap& place : places.submaps) peer.add(place.cloud.positions);
#endif
  Recall ours;
  std::ptrdiff_t near = 0;
  for (std::size_t q = 0; q < queries.submaps.size(); ++q) {
    const SE3d& query = queries.submaps[q].T_truth_submap;
    const auto T_place_query = [&](Index place) {
      return places.submaps[static_cast<std::size_t>(place)].T_truth_submap.inverse() * query;
    };
    near += std::any_of(places.submaps.begin(), places.submaps.end(), [&](const Submap& place) {
      return (place.T_truth_submap.translation() - query.translation()).norm() < 0.5 * options.cut.length;
    });
    const auto match = timed(ours, [&]() -> std::optional<PlaceMatch> {
      const auto found = index.find(queries.keypoints[q], [](Index) { return true; });
      return found.empty() ? std::nullopt : std::optional(found.front());
    });
    if (match) ours.add(match, T_place_query(match->place), options);
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
    const auto found = timed(of_peer, [&]() -> std::optional<PlaceMatch> {
      const PlaceMatch best = peer.find(queries.submaps[q].cloud.positions);
      return best.place < 0 ? std::nullopt : std::optional(best);
    });
    if (found) of_peer.add(found, T_place_query(found->place), options);
#endif
  }
  std::printf("| %zu, %td ", queries.submaps.size(), near);
  print("height images", ours, options.places.index.min_inliers, near);
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  print("MapClosures", of_peer, options.peer_inliers, near);
#endif
  std::printf("|\n");
  std::fflush(stdout);
}

void run(const Options& options) {
  std::vector<Session> sessions;
  for (std::size_t i = 0; i < options.sessions.size(); ++i) {
    sessions.push_back(read_session(options.sessions[i], options, i));
    std::fprintf(stderr, "%s: %zu submaps\n", options.sessions[i].c_str(), sessions.back().submaps.size());
  }
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  const char* peer = "| | at 100 % precision | right, wrong | query ";
  const char* peer_line = "|---|---|---|---";
#else
  const char *peer = "", *peer_line = "";
#endif
  std::printf(
      "| sessions | submaps, with a place near | | at 100 %% precision | right, wrong | query "
      "%s|\n|---|---|---|---|---|---%s|\n",
      peer, peer_line);
  for (std::size_t query = 1; query < sessions.size(); ++query)
    for (std::size_t place = 0; place < query; ++place) {
      std::printf("| %zu in %zu ", query + 1, place + 1);
      compare(sessions[place], sessions[query], options);
    }
}

}  // namespace
}  // namespace chainslam::bench

int main(int argc, char** argv) {
  chainslam::bench::Options options;
  CLI::App app("submaps of one session recognized in another");
  app.add_option("sessions", options.sessions, "keyframe sets, such as `chainslam odometry` writes, of one place")
      ->required()
      ->check(CLI::ExistingDirectory);
  app.add_option("--length", options.cut.length, "of a submap along the path, m")->capture_default_str();
  app.add_option("--spacing", options.cut.spacing, "of submaps, m")->capture_default_str();
  app.add_option("--cell-size", options.places.image.cell_size, "of height images, m")->capture_default_str();
  app.add_option("--max-range", options.places.image.max_range, "of height images, m")->capture_default_str();
  app.add_option("--tolerance", options.tolerance, "of a right one, m")->capture_default_str();
  app.add_option("--heading", options.heading, "by which sessions are turned, rad")->capture_default_str();
  app.add_option("--peer-cell-size", options.peer_cell_size, "of MapClosures, m")->capture_default_str();
  app.add_option("--transform", options.transform, "T_first_second, 16 numbers: odometry then counts as the truth");
  CLI11_PARSE(app, argc, argv);
  options.places.index.consensus.max_distance = 3 * options.places.image.cell_size;
  try {
    chainslam::bench::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
  return 0;
}
