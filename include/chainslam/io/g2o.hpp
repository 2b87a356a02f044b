#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <unordered_set>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// A variable of a pose graph and its value in the file, T_map_id.
template <class Pose>
struct G2oVertex {
  std::int64_t id = 0;  ///< as the file numbers it
  Pose pose;            ///< T_map_id
};

/// A measured T_from_to.
///
/// `information` is as the file states it, in [translation; rotation] order. g2o itself means it, in 3-D, of the
/// error's quaternion vector part, which is half the rotation vector; most benchmarks' figures read it as of the
/// rotation vector.
template <class Pose>
struct G2oEdge {
  using Information = Eigen::Matrix<double, Pose::dof, Pose::dof>;  ///< `dof` x `dof`

  std::int64_t from = 0;                              ///< id of the first vertex
  std::int64_t to = 0;                                ///< id of the second vertex
  Pose measurement;                                   ///< T_from_to
  Information information = Information::Identity();  ///< as the file states it
};

/// Vertices and edges of one kind of pose.
template <class Pose>
struct G2oRecords {
  std::vector<G2oVertex<Pose>> vertices;  ///< in the order of the file
  std::vector<G2oEdge<Pose>> edges;       ///< in the order of the file
};

/// A g2o file's records, in the order of the file. Edges may speak of vertices that the file does not give.
struct G2oFile {
  G2oRecords<SE2d> planar;               ///< VERTEX_SE2 and EDGE_SE2
  G2oRecords<SE3d> spatial;              ///< VERTEX_SE3:QUAT and EDGE_SE3:QUAT
  std::vector<std::int64_t> fixed;       ///< ids of vertices that shall not move
  std::map<std::string, Index> unknown;  ///< kinds of line that were skipped, and how many
};

namespace detail {

template <class Pose>
struct G2oNames;

template <>
struct G2oNames<SE2d> {
  static constexpr std::string_view vertex = "VERTEX_SE2";
  static constexpr std::string_view edge = "EDGE_SE2";
  static constexpr const char* vertex_layout = "VERTEX_SE2 id x y theta";
  static constexpr const char* edge_layout = "EDGE_SE2 from to x y theta and 6 of the information's upper triangle";
};

template <>
struct G2oNames<SE3d> {
  static constexpr std::string_view vertex = "VERTEX_SE3:QUAT";
  static constexpr std::string_view edge = "EDGE_SE3:QUAT";
  static constexpr const char* vertex_layout = "VERTEX_SE3:QUAT id x y z qx qy qz qw";
  static constexpr const char* edge_layout =
      "EDGE_SE3:QUAT from to x y z qx qy qz qw and 21 of the information's upper triangle";
};

inline void read_g2o_pose(LineFields& fields, SE2d& pose) {
  const double x = fields.number("x"), y = fields.number("y"), theta = fields.number("theta");
  pose = SE2d(SO2d::from_angle(theta), {x, y});
}

inline void read_g2o_pose(LineFields& fields, SE3d& pose) {
  const Eigen::Vector3d position = read_position(fields);
  pose = SE3d(read_quaternion(fields, QuaternionOrder::xyzw), position);
}

template <class Pose>
G2oVertex<Pose> read_g2o_vertex(LineFields& fields) {
  G2oVertex<Pose> vertex;
  vertex.id = fields.integer("id");
  read_g2o_pose(fields, vertex.pose);
  fields.end(G2oNames<Pose>::vertex_layout);
  return vertex;
}

template <class Pose>
G2oEdge<Pose> read_g2o_edge(LineFields& fields) {
  G2oEdge<Pose> edge;
  edge.from = fields.integer("from");
  edge.to = fields.integer("to");
  if (edge.from == edge.to) fields.fail("to", "an edge from a vertex to itself", "remove the line");
  read_g2o_pose(fields, edge.measurement);
  for (int i = 0; i < Pose::dof; ++i)
    for (int k = i; k < Pose::dof; ++k) edge.information(i, k) = edge.information(k, i) = fields.number("information");
  for (int i = 0; i < Pose::dof; ++i)
    if (edge.information(i, i) < 0)
      fields.fail("information", "a negative number on the diagonal", "information is positive semi-definite");
  fields.end(G2oNames<Pose>::edge_layout);
  return edge;
}

/// Takes the line if it is one of `Pose`'s. @returns whether it was.
template <class Pose>
bool take_g2o_line(std::string_view tag, LineFields& fields, G2oRecords<Pose>& records,
                   std::unordered_set<std::int64_t>& ids) {
  if (tag == G2oNames<Pose>::vertex) {
    records.vertices.push_back(read_g2o_vertex<Pose>(fields));
    if (!ids.insert(records.vertices.back().id).second)
      fields.fail("id", std::to_string(records.vertices.back().id) + " a second time", "give each vertex its own id");
    return true;
  }
  if (tag == G2oNames<Pose>::edge) {
    records.edges.push_back(read_g2o_edge<Pose>(fields));
    return true;
  }
  return false;
}

inline void append_g2o_pose(std::string& line, const SE2d& pose) {
  for (const double value : {pose.translation()[0], pose.translation()[1], pose.rotation().angle()}) {
    line += ' ';
    append_number(line, value);
  }
}

inline void append_g2o_pose(std::string& line, const SE3d& pose) {
  append_position(line, pose.translation());
  append_quaternion(line, pose.rotation());
}

template <class Pose>
void write_g2o_vertices(const FileTarget& target, AtomicFile& file, const G2oRecords<Pose>& records) {
  for (const G2oVertex<Pose>& vertex : records.vertices) {
    require_finite(target, "vertex", vertex.id, vertex.pose);
    std::string line(G2oNames<Pose>::vertex);
    append_number(line += ' ', vertex.id);
    append_g2o_pose(line, vertex.pose);
    file.write(line += '\n');
  }
}

template <class Pose>
void write_g2o_edges(const FileTarget& target, AtomicFile& file, const G2oRecords<Pose>& records) {
  for (const G2oEdge<Pose>& edge : records.edges) {
    require_finite(target, "edge to vertex", edge.to, edge.measurement);
    if (!is_finite(edge.information)) throw_not_finite(target, "edge to vertex", edge.to);
    std::string line(G2oNames<Pose>::edge);
    append_number(line += ' ', edge.from);
    append_number(line += ' ', edge.to);
    append_g2o_pose(line, edge.measurement);
    for (int i = 0; i < Pose::dof; ++i)
      for (int k = i; k < Pose::dof; ++k) append_number(line += ' ', edge.information(i, k));
    file.write(line += '\n');
  }
}

}  // namespace detail

/// Reads a pose graph: VERTEX_SE2, VERTEX_SE3:QUAT, EDGE_SE2, EDGE_SE3:QUAT and FIX lines; '#' starts a comment line.
/// Lines of other kinds are counted in `unknown`.
/// Format: Kuemmerle et al. 2011, g2o: a general framework for graph optimization.
/// @throws IoError naming line and field: not a finite number, missing or extra fields, a vertex given twice, an edge
/// to
///   itself, a quaternion whose length is not 1 within 1e-3, information with a negative diagonal.
[[nodiscard]] inline G2oFile read_g2o(const std::filesystem::path& path) {
  InputFile file(path);
  G2oFile graph;
  std::unordered_set<std::int64_t> ids;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text);
    const std::string_view tag = fields.text("tag");
    if (tag == "FIX") {
      do graph.fixed.push_back(fields.integer("id"));
      while (fields.more());
    } else if (!detail::take_g2o_line(tag, fields, graph.planar, ids) &&
               !detail::take_g2o_line(tag, fields, graph.spatial, ids)) {
      ++graph.unknown[std::string(tag.substr(0, 64))];
    }
  }
  return graph;
}

/// Writes a pose graph: vertices, FIX, edges; numbers as short as reads back the same. `unknown` is not written.
/// @throws IoError if a number is not finite or it cannot be written; the old file then stays.
inline void write_g2o(const FileTarget& target, const G2oFile& graph) {
  AtomicFile file(target);
  detail::write_g2o_vertices(target, file, graph.planar);
  detail::write_g2o_vertices(target, file, graph.spatial);
  for (const std::int64_t id : graph.fixed) file.write("FIX " + std::to_string(id) + '\n');
  detail::write_g2o_edges(target, file, graph.planar);
  detail::write_g2o_edges(target, file, graph.spatial);
  file.commit();
}

}  // namespace chainslam
