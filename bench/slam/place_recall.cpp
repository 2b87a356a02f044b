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
#include <memory>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/slam/place_candidates.hpp"
#include "descriptor_table.hpp"
#include "keyframe_sets.hpp"
#include "place_verification.hpp"
#include "slam/place_recall/submaps.hpp"
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
#include "slam/peers/map_closures.hpp"
#endif

namespace chainslam::bench {
namespace {

[[maybe_unused]] constexpr double map_closures_inliers = 5;  // as its own pipeline asks for

struct Options {
  std::vector<std::filesystem::path> sessions;
  SubmapCut cut{};
  PlaceCandidateOptions places{};
  double tolerance = 2.0;           // metres
  double tolerance_deg = 5.0;       // degrees
  double heading = 0.6;             // radians by which each session's odometry is turned against the one before
  double peer_cell_size = 0.5;      // metres
  bool triangles = false;           // compare with LAMM's, too
  std::filesystem::path transform;  // T_first_second of two sessions whose truth is not in one frame
};

struct Session {
  std::vector<Submap> submaps;
  std::vector<std::vector<ImageKeypoint>> keypoints;
  std::vector<std::shared_ptr<const PlaceDescriptor>> triangles;  // LAMM's
};

/// A place as any recognizer gives it. @param score  by which right and wrong ones are told apart
struct Recognized {
  Index place = 0;
  SE2d T_place_query;
  double score = 0;
};

SE2d from_above(const SE3d& T) {
  const Eigen::Matrix3d R = T.rotation().matrix();
  return SE2d(SO2d::from_angle(std::atan2(R(1, 0), R(0, 0))), T.translation().head<2>());
}

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
  Session session;
  session.submaps = submaps_of(set.keyframes, truth_of(set, options, number == 0), cut);
  for (const Submap& submap : session.submaps)
    session.keypoints.push_back(
        image_keypoints(height_image(submap.cloud, options.places.image), options.places.keypoints));
  if (options.triangles)
    for (const Submap& submap : session.submaps)
      session.triangles.push_back(std::make_shared<const PlaceDescriptor>(describe_place(submap.cloud)));
  return session;
}

/// What a recognizer makes of all queries.
class Recall {
 public:
  /// Asks it once. @param find  gives what it recognizes, if anything. @param truth  T_place_query of a place
  template <class Find, class Truth>
  void ask(const Find& find, const Truth& truth, const Options& options) {
    const auto begin = std::chrono::steady_clock::now();
    const std::optional<Recognized> found = find();
    seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    ++queries_;
    if (!found) return;
    const SE2d T_place_query = from_above(truth(found->place));
    const double turn = std::remainder(T_place_query.rotation().angle() - found->T_place_query.rotation().angle(),
                                       2 * std::numbers::pi);
    const double off = (T_place_query.translation() - found->T_place_query.translation()).norm();
    const bool is_right = off < options.tolerance && std::abs(turn) < options.tolerance_deg * std::numbers::pi / 180;
    (is_right ? right_ : wrong_).push_back(found->score);
  }

  /// Right ones whose score no wrong one reaches.
  [[nodiscard]] std::ptrdiff_t at_full_precision() const {
    const double worst = wrong_.empty() ? 0 : *std::max_element(wrong_.begin(), wrong_.end());
    return std::count_if(right_.begin(), right_.end(), [&](double score) { return score > worst; });
  }
  [[nodiscard]] std::ptrdiff_t right(double least) const { return at_least(right_, least); }
  [[nodiscard]] std::ptrdiff_t wrong(double least) const { return at_least(wrong_, least); }
  [[nodiscard]] double milliseconds() const { return queries_ > 0 ? 1e3 * seconds_ / queries_ : 0; }

 private:
  [[nodiscard]] static std::ptrdiff_t at_least(const std::vector<double>& scores, double least) {
    return std::count_if(scores.begin(), scores.end(), [&](double score) { return score >= least; });
  }
  std::vector<double> right_, wrong_;
  double seconds_ = 0;
  int queries_ = 0;
};

void print(const Recall& recall, double least, std::ptrdiff_t queries) {
  const double share =
      queries > 0 ? 100.0 * static_cast<double>(recall.at_full_precision()) / static_cast<double>(queries) : 0;
  std::printf("| %td (%.0f %%) | %td, %td | %.1f ms ", recall.at_full_precision(), share, recall.right(least),
              recall.wrong(least), recall.milliseconds());
}

void compare(const Session& places, const Session& queries, const Options& options) {
  PlaceIndexOptions index_options = options.places.index;
  index_options.min_inliers = 3;  // all that it finds: the score decides
  PlaceIndex index(index_options);
  for (const auto& keypoints : places.keypoints) index.add(keypoints);
  DescriptorTable table;
  for (const auto& triangles : places.triangles) table.add(triangles);
  VerificationOptions verification;
  verification.min_overlap = 0;
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  MapClosuresPlaces peer(options.peer_cell_size);
  Recall of_peer;
  for (const Submap& place : places.submaps) peer.add(place.cloud.positions);
#endif
  Recall of_images, of_triangles;
  std::ptrdiff_t near = 0;
  for (std::size_t q = 0; q < queries.submaps.size(); ++q) {
    const SE3d& query = queries.submaps[q].T_truth_submap;
    const auto truth = [&](Index place) {
      return places.submaps[static_cast<std::size_t>(place)].T_truth_submap.inverse() * query;
    };
    near += std::any_of(places.submaps.begin(), places.submaps.end(), [&](const Submap& place) {
      return (place.T_truth_submap.translation() - query.translation()).norm() < 0.5 * options.cut.length;
    });
    const auto by_images = [&]() -> std::optional<Recognized> {
      const auto found = index.find(queries.keypoints[q], [](Index) { return true; });
      if (found.empty()) return std::nullopt;
      return Recognized{found[0].place, found[0].T_place_query, static_cast<double>(found[0].inliers)};
    };
    of_images.ask(by_images, truth, options);
    const auto by_triangles = [&]() -> std::optional<Recognized> {
      const PlaceDescriptor& seen = *queries.triangles[q];
      const auto found = recognize(seen, table, table.candidates(seen, [](Index) { return true; }), verification);
      if (!found) return std::nullopt;
      return Recognized{found->place, from_above(found->T_place_query), found->overlap};
    };
    if (options.triangles) of_triangles.ask(by_triangles, truth, options);
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
    const auto by_peer = [&]() -> std::optional<Recognized> {
      const PlaceMatch best = peer.find(queries.submaps[q].cloud.positions);
      if (best.place < 0) return std::nullopt;
      return Recognized{best.place, best.T_place_query, static_cast<double>(best.inliers)};
    };
    of_peer.ask(by_peer, truth, options);
#endif
  }
  std::printf("| %zu, %td ", queries.submaps.size(), near);
  print(of_images, options.places.index.min_inliers, near);
  if (options.triangles) print(of_triangles, VerificationOptions{}.min_overlap, near);
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  print(of_peer, map_closures_inliers, near);
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
  std::vector<std::string> methods{"height images"};
  if (options.triangles) methods.push_back("LAMM's triangles");
#ifdef CHAINSLAM_PEER_MAP_CLOSURES
  methods.push_back("MapClosures");
#endif
  std::string title = "| sessions | submaps, with a place near ", line = "|---|---";
  for (const std::string& method : methods) {
    title += "| " + method + ": right at 100 % precision | right, wrong by default | query ";
    line += "|---|---|---";
  }
  std::printf("%s|\n%s|\n", title.c_str(), line.c_str());
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
  app.add_flag("--triangles", options.triangles, "compare with the triangles of LAMM");
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
