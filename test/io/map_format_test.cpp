#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

using chainslam::detail::ChunkHeader;
using chainslam::detail::ChunkType;
using chainslam::detail::ZstdCodec;
using Bytes = std::vector<std::byte>;

/// One chunk, its payload as it is stored.
struct Chunk {
  ChunkHeader header;
  Bytes payload;

  [[nodiscard]] bool is(ChunkType type) const { return header.is(type); }
};

/// Takes a file apart, lets `edit` change its chunks, and puts it together again with checksums, sequence, index and
/// end as they should be: what a program would write that does not keep to the rules.
template <class Edit>
void rewrite(const std::filesystem::path& from, const std::filesystem::path& to, Edit&& edit) {
  const std::string text = read_bytes(from);
  std::vector<Chunk> chunks;
  {
    const chainslam::detail::MapFileReader file(from);
    for (std::size_t i = 0; i < file.chunks().size(); ++i)
      chunks.push_back({file.chunks()[i].header, *file.stored_payload(i)});
  }
  edit(chunks);
  Bytes out;
  for (const char c : text.substr(0, 64)) out.push_back(static_cast<std::byte>(c));
  Bytes index;
  std::uint64_t index_offset = 0;
  for (std::size_t i = 0; i < chunks.size(); ++i) {
    Chunk& chunk = chunks[i];
    if (chunk.is(ChunkType::index)) {
      index_offset = out.size();
      chunk.payload = index;
      chunk.header.count = static_cast<std::uint32_t>(i);
    }
    if (chunk.is(ChunkType::end)) {
      chunk.payload.clear();
      append_bytes(chunk.payload, index_offset);
      append_bytes(chunk.payload, std::uint64_t{out.size() + 128});
    }
    append_bytes(index, std::uint64_t{out.size()});
    append_bytes(index, chunk.header.type);
    append_bytes(index, chunk.header.version);
    append_bytes(index, chunk.header.count);
    chunk.header.sequence = i;
    if (chunk.header.codec == RawCodec::id && chunk.header.raw_bytes <= (1U << 28))
      chunk.header.raw_bytes = chunk.payload.size();
    chainslam::detail::append_chunk(out, chunk.header, chunk.payload);
  }
  write_bytes(to, std::string_view(reinterpret_cast<const char*>(out.data()), out.size()));
}

/// What loading says of a map whose first chunk of `type` was changed.
template <class Change>
std::string after_change(ChunkType type, Change&& change, bool recover = true) {
  const TemporaryFolder folder;
  save_map(folder / "a", random_map(4, 12), {}, UnsyncedFiles{});
  rewrite(folder / "a", folder / "b", [&](std::vector<Chunk>& chunks) {
    for (Chunk& chunk : chunks)
      if (chunk.is(type)) return change(chunk);
    FAIL("no such chunk");
  });
  return io_error([&] { return load_map(folder / "b", {.recover = recover}); });
}

/// Overwrites a number in a payload.
template <class T>
auto put(std::size_t offset, T value) {
  return [offset, value](Chunk& chunk) {
    Bytes bytes;
    append_bytes(bytes, value);
    REQUIRE(offset + bytes.size() <= chunk.payload.size());
    std::copy(bytes.begin(), bytes.end(), chunk.payload.begin() + static_cast<std::ptrdiff_t>(offset));
  };
}

/// Cuts each record of a block, or lets it grow by what no version has written.
void resize_records(Chunk& chunk, std::size_t size) {
  const std::size_t before = load_as<std::uint32_t>(chunk.payload.data() + 4);
  Bytes resized(chunk.payload.begin(), chunk.payload.begin() + 4);
  append_bytes(resized, static_cast<std::uint32_t>(size));
  resized.insert(resized.end(), chunk.payload.begin() + 8, chunk.payload.begin() + 16);
  for (std::size_t i = 0; i < chunk.header.count; ++i) {
    const auto record = chunk.payload.begin() + static_cast<std::ptrdiff_t>(16 + before * i);
    resized.insert(resized.end(), record, record + static_cast<std::ptrdiff_t>(std::min(before, size)));
    resized.resize(16 + size * (i + 1), std::byte{77});
  }
  chunk.payload = resized;
}

/// Where the first chunk of frames begins in a file.
std::size_t frames_chunk(std::string_view file) {
  const std::size_t at = file.find(std::string("CHNK\x0d\0", 6));
  REQUIRE(at != std::string::npos);
  return at;
}

/// One of the records of `size` bytes in that chunk.
const std::byte* frame_record(std::string_view file, std::size_t i, std::size_t size) {
  const std::byte* chunk = std::as_bytes(std::span(file)).data() + frames_chunk(file);
  REQUIRE(load_as<std::uint32_t>(chunk + 68) == size);
  return chunk + 64 + 16 + i * size;
}

/// Changes the file's own header and its checksum.
std::string with_header(const std::filesystem::path& path, std::size_t offset, char value) {
  std::string text = read_bytes(path);
  text[offset] = value;
  const auto hash = chainslam::detail::hash_of(std::as_bytes(std::span(text).first(56)));
  return text.substr(0, 56) + little(hash) + text.substr(64);
}

/// The map of test/io/golden, format 1.0: numbers that every machine writes the same way.
SlamMap golden_map_1_0() {
  SlamMap map;
  const auto pose = [](double x) {
    return SE3d(SO3d::from_quaternion(SO3d::Quaternion(0.6, 0, 0, 0.8)), {x, -x, 0.25});
  };
  const auto root = [](double value) {
    SqrtInformation<6> matrix = SqrtInformation<6>::Zero();
    for (Eigen::Index i = 0; i < 6; ++i) matrix(i, i) = value + static_cast<double>(i);
    matrix(0, 5) = -0.5;
    return matrix;
  };
  map.sessions.push_back({SessionId{0}, "morning", 0, 3, SessionId{0}, pose(0), root(1000)});
  map.sessions.push_back({SessionId{1}, "", 3, 2, SessionId{0}, pose(9), root(0.1)});
  for (Index i = 0; i < 5; ++i) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{i};
    keyframe.session = SessionId{i < 3 ? 0 : 1};
    keyframe.time = Timestamp::from_nanoseconds(1'000'000'000'000'000'000 + 500'000'000LL * i);
    keyframe.T_odom_body = pose(i);
    keyframe.T_map_body = pose(i + 0.125);
    PointCloud<float> cloud;
    for (int k = 0; k < 40; ++k)
      cloud.positions.emplace_back(0.75F * static_cast<float>(k * k % 97), -0.5F * static_cast<float>(k),
                                   0.25F * static_cast<float>(i + k % 5));
    if (i == 2) {
      cloud.normals.assign(cloud.size(), {0, 0, 1});
      cloud.time_offsets.assign(cloud.size(), 0.0625F);
      cloud.intensities.assign(cloud.size(), 17);
      cloud.positions[0] = {1.0F / 3, 0, 0};  // on no grid
    }
    if (i != 4) keyframe.cloud = std::make_shared<const PointCloud<float>>(i == 2 ? cloud : quantized(cloud));
    map.keyframes.push_back(std::move(keyframe));
  }
  map.keyframes[1].gnss =
      GnssFix{map.keyframes[1].time, {4e6, 9e5, 4.8e6}, Eigen::Matrix3d::Identity() * 2.25, GnssQuality::differential};
  for (const Index i : {1, 2, 4}) map.odometry.push_back({KeyframeId{i - 1}, KeyframeId{i}, pose(1), root(20)});
  LoopClosure closure;
  closure.from = KeyframeId{0};
  closure.to = KeyframeId{3};
  closure.T_from_to = pose(3);
  closure.sqrt_information = root(50);
  closure.kind = ClosureKind::merge;
  closure.mean_squared_error = 0.0625;
  closure.inlier_ratio = 0.875;
  map.closures.push_back(closure);
  closure.to = KeyframeId{4};
  closure.kind = ClosureKind::direct;
  closure.cause = 0;
  map.closures.push_back(closure);
  closure.verdict = ClosureVerdict::unconfirmed;
  closure.sqrt_information.setZero();
  map.refusals.push_back(closure);
  return map;
}

/// The same with frames, as format 1.1 has them.
SlamMap golden_map_1_1() {
  SlamMap map = golden_map_1_0();
  for (Index i = 0; i < 12; ++i) {
    FrameRecord frame;
    frame.session = SessionId{i < 8 ? 0 : 1};
    frame.time = Timestamp::from_nanoseconds(1'000'000'000'000'000'000 + 125'000'000LL * i);
    frame.T_odom_body = map.keyframes[static_cast<std::size_t>(i % 5)].T_odom_body;
    Matrix6d covariance = 0.25 * Matrix6d::Identity();
    covariance(0, 5) = covariance(5, 0) = -0.125 * i / 16;
    frame.covariance = PackedCovariance(covariance);
    frame.health = {.status = i == 3   ? FrameStatus::degenerate
                              : i == 5 ? FrameStatus::lost
                                       : FrameStatus::good,
                    .points = 1000 + i,
                    .matches = 900 - i,
                    .residual_rms = 0.03125,
                    .iterations = 4,
                    .map_restarted = i == 5,
                    .after_gap = i == 6};
    if (i < 8) frame.health.imu_use = static_cast<ImuUse>(i % 4);
    map.frames.push_back(frame);
  }
  return map;
}

/// The same with a closure that was taken back, as format 1.2 has it.
SlamMap golden_map_1_2() {
  SlamMap map = golden_map_1_1();
  map.closures[1].verdict = ClosureVerdict::reverted;
  return map;
}

/// The same with what the accelerometer measured before some of the frames, as format 1.3 has it.
SlamMap golden_map_1_3() {
  SlamMap map = golden_map_1_2();
  int i = 0;
  change_frames(map, [&](FrameRecord& frame) {
    if (i != 0 && i != 5 && i != 8)
      frame.delta_velocity = Eigen::Vector3f(0.0625F * static_cast<float>(i), -0.03125F, 1.2265625F);
    ++i;
  });
  return map;
}

/// The same with two fixes that came together after a later keyframe, as format 1.4 has them.
SlamMap golden_map() {
  SlamMap map = golden_map_1_3();
  map.keyframes[2].gnss = map.keyframes[1].gnss;
  map.keyframes[2].gnss->time = map.keyframes[2].time;
  map.keyframes[1].gnss_arrival = {KeyframeId{2}, false};
  map.keyframes[2].gnss_arrival = {KeyframeId{2}, true};
  return map;
}

MapArchiveOptions golden_options() {
  return {.parameters = "# golden\nstep = 0.01\n",
          .unknown = {{0x0123, 1, 0, 2, 3, {std::byte{1}, std::byte{2}, std::byte{3}}}}};
}

/// Optimized poses of the graph that a map's records describe.
std::vector<SE3d> optimum(const SlamMap& map) {
  PoseGraph graph;
  for (const Keyframe& keyframe : map.keyframes) graph.add_value(keyframe.T_map_body);
  graph.set_fixed(0);
  const auto add = [&](KeyframeId from, KeyframeId to, const SE3d& T_from_to, const SqrtInformation<6>& root) {
    graph.add_between(from.value, to.value, T_from_to, NoiseModel<6>::from_information(root.transpose() * root));
  };
  for (const OdometryMeasurement& step : map.odometry) add(step.from, step.to, step.T_from_to, step.sqrt_information);
  for (const LoopClosure& closure : map.closures)
    add(closure.from, closure.to, closure.T_from_to, closure.sqrt_information);
  REQUIRE(optimize(graph, LevenbergMarquardt{.max_iterations = 100}).ok());
  std::vector<SE3d> poses;
  for (const Keyframe& keyframe : map.keyframes) poses.push_back(graph[keyframe.id.value]);
  return poses;
}

/// A drive around a ring of 40 keyframes, whose odometry drifts, with closures between its laps.
SlamMap ring() {
  constexpr Index count = 40;
  Rng rng(1);
  SlamMap map;
  map.sessions.push_back(
      {SessionId{0}, "ring", 0, count, SessionId{0}, SE3d(), SqrtInformation<6>(1e4 * Matrix6d::Identity())});
  const auto truth = [](Index i) {
    Vector6d step;
    step << 1, 0, 0, 0, 0, 0.314;
    return SE3d::exp(step * static_cast<double>(i));
  };
  const auto noisy = [&](const SE3d& T, double sigma) {
    Vector6d noise;
    for (Eigen::Index i = 0; i < 6; ++i) noise[i] = rng.normal(0, sigma);
    return T.retract(noise);
  };
  for (Index i = 0; i < count; ++i) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{i};
    keyframe.session = SessionId{0};
    keyframe.time = Timestamp::from_nanoseconds(1'000'000'000LL * i);
    if (i > 0) {
      const SE3d step = noisy(truth(i - 1).inverse() * truth(i), 0.01);
      keyframe.T_odom_body = map.keyframes.back().T_odom_body * step;
      map.odometry.push_back({KeyframeId{i - 1}, KeyframeId{i}, step, random_root(rng)});
    }
    keyframe.T_map_body = keyframe.T_odom_body;
    map.keyframes.push_back(keyframe);
  }
  for (Index i = 20; i < count; i += 3) {
    LoopClosure closure;
    closure.from = KeyframeId{i - 20};
    closure.to = KeyframeId{i};
    closure.T_from_to = noisy(truth(i - 20).inverse() * truth(i), 0.002);
    closure.sqrt_information = random_root(rng);
    map.closures.push_back(closure);
  }
  return map;
}

}  // namespace

TEST_SUITE("io/map_format") {
  TEST_CASE("write the golden file of the format, once for each version of it" * doctest::skip()) {
    const std::string name = "map_" + std::to_string(chainslam::detail::map_major) + '_' +
                             std::to_string(chainslam::detail::map_minor) + ".cslam";
    save_map(CHAINSLAM_SOURCE_DIR "/test/io/golden/" + name, golden_map(), golden_options());
  }

  TEST_CASE("the golden file of format 1.0 says what it said when it was made") {
    const LoadedMap loaded = load_map(CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_0.cslam");
    CHECK(loaded.report.complete);
    CHECK(loaded.report.format_major == 1);
    CHECK(loaded.report.format_minor == 0);
    CHECK(loaded.parameters == golden_options().parameters);
    CHECK(loaded.unknown == golden_options().unknown);
    CHECK(same_map(loaded.map, golden_map_1_0()));
    CHECK(loaded.map.frames.empty());
    const TemporaryFolder folder;
    save_map(folder / "again", loaded);  // in the format of today
    CHECK(load_map(folder / "again").report.format_minor == chainslam::detail::map_minor);
    CHECK(same_map(load_map(folder / "again").map, golden_map_1_0()));
  }

  TEST_CASE("the golden file of format 1.1 says what it said when it was made") {
    const std::string path = CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_1.cslam";
    const LoadedMap loaded = load_map(path);
    CHECK(loaded.report.complete);
    CHECK(loaded.report.format_minor == 1);
    CHECK(loaded.parameters == golden_options().parameters);
    CHECK(loaded.unknown == golden_options().unknown);
    CHECK(same_map(loaded.map, golden_map_1_1()));
    const TemporaryFolder folder;
    save_map(folder / "again", loaded);
    CHECK(load_map(folder / "again").report.format_minor == chainslam::detail::map_minor);
    CHECK(same_map(load_map(folder / "again").map, golden_map_1_1()));
  }

  TEST_CASE("the golden file of format 1.2 says what it said when it was made") {
    const std::string path = CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_2.cslam";
    const LoadedMap loaded = load_map(path);
    CHECK(loaded.report.complete);
    CHECK(loaded.report.format_minor == 2);
    CHECK_FALSE(loaded.report.newer_fields);
    CHECK(same_map(loaded.map, golden_map_1_2()));
    const TemporaryFolder folder;
    save_map(folder / "again", loaded);
    CHECK(load_map(folder / "again").report.format_minor == chainslam::detail::map_minor);
    CHECK(same_map(load_map(folder / "again").map, golden_map_1_2()));
  }

  TEST_CASE("the golden file of format 1.3 says what it said when it was made") {
    const std::string path = CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_3.cslam";
    const LoadedMap loaded = load_map(path);
    CHECK(loaded.report.complete);
    CHECK(loaded.report.format_minor == 3);
    CHECK_FALSE(loaded.report.newer_fields);
    CHECK(same_map(loaded.map, golden_map_1_3()));
    CHECK_FALSE(same_map(loaded.map, golden_map_1_2()));
    const TemporaryFolder folder;
    save_map(folder / "again", loaded);
    CHECK(load_map(folder / "again").report.format_minor == chainslam::detail::map_minor);
    CHECK(same_map(load_map(folder / "again").map, golden_map_1_3()));
  }

  TEST_CASE("the golden file of format 1.4 says what it said when it was made") {
    const std::string path = CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_4.cslam";
    const LoadedMap loaded = load_map(path);
    CHECK(loaded.report.complete);
    CHECK(loaded.report.format_minor == 4);
    CHECK_FALSE(loaded.report.newer_fields);
    CHECK(loaded.parameters == golden_options().parameters);
    CHECK(loaded.unknown == golden_options().unknown);
    CHECK(same_map(loaded.map, golden_map()));
    CHECK_FALSE(same_map(loaded.map, golden_map_1_3()));
    const TemporaryFolder folder;
    save_map(folder / "again", loaded);
    CHECK(read_bytes(folder / "again") == read_bytes(path));
  }

  TEST_CASE("frames lie in the file as they are described, and a damaged chunk loses only them") {
    const TemporaryFolder folder;
    const std::string path = CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_1.cslam";
    std::string file = read_bytes(path);
    const std::size_t at = frames_chunk(file);
    const std::byte* record = frame_record(file, 5, 172);
    CHECK(load_as<std::int64_t>(record) == 1'000'000'000'625'000'000);
    CHECK(load_as<std::int32_t>(record + 8) == 0);
    CHECK(load_as<std::uint8_t>(record + 12) == 2);  // lost
    CHECK(load_as<std::uint8_t>(record + 13) == 1);  // the local map was restarted
    CHECK(load_as<std::uint8_t>(record + 14) == 1);  // gyroscope
    CHECK(load_as<std::uint8_t>(record + 172 + 13) == 2);
    CHECK(load_as<std::uint8_t>(record + 3 * 172 + 14) == 255);
    CHECK(load_as<std::int32_t>(record + 16) == 1005);
    CHECK(load_as<std::int32_t>(record + 20) == 895);
    CHECK(load_as<std::int32_t>(record + 24) == 4);
    CHECK(load_as<float>(record + 28) == 0.03125F);
    CHECK(load_as<double>(record + 32 + 6 * 8) == 0.6);  // w of the quaternion
    CHECK(load_as<float>(record + 88) == 0.25F);
    CHECK(load_as<float>(record + 88 + 5 * 4) == -0.0390625F);  // row 0, column 5
    CHECK(load_as<float>(record + 88 + 20 * 4) == 0.25F);

    file[at + 64 + 40] ^= 1;
    write_bytes(folder / "damaged", file);
    CHECK(says(io_error([&] { return load_map(folder / "damaged"); }), "(frames)"));
    const LoadedMap loaded = load_map(folder / "damaged", {.recover = true});
    CHECK(same_map(loaded.map, golden_map_1_0()));
    CHECK_FALSE(loaded.report.complete);
  }

  TEST_CASE("what the accelerometer measured stands behind a frame's covariance; three NaN say that it did not") {
    const std::string file = read_bytes(CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_3.cslam");
    const std::byte* record = frame_record(file, 7, 184);
    CHECK(load_as<std::int64_t>(record) == 1'000'000'000'875'000'000);
    CHECK(load_as<float>(record + 88 + 20 * 4) == 0.25F);  // the covariance's last entry
    CHECK(load_as<float>(record + 172) == 0.4375F);
    CHECK(load_as<float>(record + 176) == -0.03125F);
    CHECK(load_as<float>(record + 180) == 1.2265625F);
    for (const std::size_t unmeasured : {0U, 5U, 8U})
      for (const std::size_t offset : {172U, 176U, 180U})
        CHECK(std::isnan(load_as<float>(frame_record(file, unmeasured, 184) + offset)));
  }

  TEST_CASE("a fix states after which keyframe it came, and whether with that of the keyframe before") {
    const TemporaryFolder folder;
    const SlamMap map = golden_map();
    save_map(folder / "a", map);
    rewrite(folder / "a", folder / "b", [](std::vector<Chunk>& chunks) {
      for (Chunk& chunk : chunks) {
        if (!chunk.is(ChunkType::gnss)) continue;
        CHECK(load_as<std::uint32_t>(chunk.payload.data() + 4) == 120);
        const std::byte* record = chunk.payload.data() + 16;
        CHECK(load_as<std::int32_t>(record + 112) == 2);
        CHECK(load_as<std::uint32_t>(record + 116) == 0);
        CHECK(load_as<std::int32_t>(record + 120 + 112) == 2);
        CHECK(load_as<std::uint32_t>(record + 120 + 116) == 1);
        resize_records(chunk, 112);
      }
    });
    const LoadedMap loaded = load_map(folder / "b");  // as earlier versions wrote them
    CHECK(loaded.report.complete);
    CHECK_FALSE(loaded.report.newer_fields);
    CHECK(loaded.map.keyframes[2].gnss.has_value());
    CHECK_FALSE(loaded.map.keyframes[2].gnss_arrival.after.valid());
    for (const std::size_t size : {111U, 113U, 116U, 119U})
      CHECK(says(after_change(ChunkType::gnss, [&](Chunk& chunk) { resize_records(chunk, size); }), "record size"));
    CHECK(after_change(ChunkType::gnss, [](Chunk& chunk) { resize_records(chunk, 128); }).empty());
    CHECK(says(after_change(ChunkType::gnss, put(16 + 112, std::int32_t{12})), "keyframe after which it came"));
    CHECK(says(after_change(ChunkType::gnss, put(16 + 112, std::int32_t{-2})), "keyframe after which it came"));
  }

  TEST_CASE("frames of earlier versions have nothing of the accelerometer, also among frames of today") {
    const TemporaryFolder folder;
    SlamMap map = random_map(4, 12);
    save_map(folder / "a", map);
    rewrite(folder / "a", folder / "b", [](std::vector<Chunk>& chunks) {
      for (Chunk& chunk : chunks)
        if (chunk.is(ChunkType::frames)) resize_records(chunk, 172);
    });
    const LoadedMap loaded = load_map(folder / "b");
    CHECK(loaded.report.complete);
    CHECK_FALSE(loaded.report.newer_fields);
    CHECK_FALSE(same_map(loaded.map, map));
    change_frames(map, [](FrameRecord& frame) { frame.delta_velocity.reset(); });
    CHECK(same_map(loaded.map, map));
  }

  TEST_CASE("frames whose records have a size that no version wrote are refused, longer ones are read") {
    for (const std::size_t size : {171U, 173U, 176U, 183U})
      CHECK(says(after_change(ChunkType::frames, [&](Chunk& chunk) { resize_records(chunk, size); }), "record size"));
    CHECK(after_change(ChunkType::frames, [](Chunk& chunk) { resize_records(chunk, 192); }).empty());
  }

  TEST_CASE("frames that cannot be are refused with record and field") {
    const std::size_t second = 16 + 184;
    CHECK(says(after_change(ChunkType::frames, put(second + 12, std::uint8_t{3})), "record 1, status"));
    CHECK(says(after_change(ChunkType::frames, put(second + 14, std::uint8_t{4})), "record 1, use of the IMU"));
    CHECK(says(after_change(ChunkType::frames, put(second + 8, std::int32_t{2})), "record 1, session"));
    CHECK(says(after_change(ChunkType::frames, put(second, std::int64_t{5})), "record 1, time"));
    CHECK(says(after_change(ChunkType::frames, put(second + 32, std::nan(""))), "record 1, T_odom_body"));
    CHECK(says(after_change(ChunkType::frames, put(second + 88, -1.0F)), "record 1, covariance"));
    CHECK(says(after_change(ChunkType::frames, put(second + 176, HUGE_VALF)), "record 1, delta velocity"));
    CHECK(says(after_change(ChunkType::frames, put(0, std::int32_t{1})), "record 0, number"));
    const TemporaryFolder folder;
    SlamMap map = random_map(4, 5);
    const PackedCovariance unknown(std::array<float, 21>{std::nanf("")});
    change_frames(map, [&](FrameRecord& frame) { frame.covariance = unknown; });
    CHECK_THROWS_AS(save_map(folder / "a", map), std::invalid_argument);
    map = random_map(4, 5);
    change_frames(map, [](FrameRecord& frame) { frame.delta_velocity = Eigen::Vector3f(0, std::nanf(""), 1); });
    CHECK_THROWS_AS(save_map(folder / "a", map), std::invalid_argument);
  }

  TEST_CASE("a reader made from the description alone finds the golden map") {
    const std::string file = read_bytes(CHAINSLAM_SOURCE_DIR "/test/io/golden/map_1_0.cslam");
    const auto bytes = std::as_bytes(std::span(file));
    const auto u16 = [&](std::size_t at) { return load_as<std::uint16_t>(bytes.data() + at); };
    const auto u32 = [&](std::size_t at) { return load_as<std::uint32_t>(bytes.data() + at); };
    const auto u64 = [&](std::size_t at) { return load_as<std::uint64_t>(bytes.data() + at); };
    const SlamMap map = golden_map_1_0();
    CHECK(u16(8) == 1);
    CHECK(u32(12) == 64);
    CHECK(u64(56) == XXH3_64bits(file.data(), 56));
    std::uint64_t sequence = 0;
    std::map<unsigned, int> found;
    for (std::size_t at = 64; at < file.size(); ++sequence) {
      const std::uint64_t stored = u64(at + 16), raw = u64(at + 24), space = (stored + 63) / 64 * 64;
      CHECK(file.substr(at, 4) == "CHNK");
      CHECK(u64(at + 32) == sequence);
      CHECK(u64(at + 40) == u64(16));
      CHECK(u64(at + 48) == XXH3_64bits(file.data() + at + 64, space));
      CHECK(u64(at + 56) == XXH3_64bits(file.data() + at, 56));
      const unsigned type = u16(at + 4);
      const std::size_t payload = at + 64, block = payload + 16;
      ++found[type];
      if (type == 0x8003) {
        CHECK(u32(payload + 4) == 72);
        CHECK(u64(block + 2 * 72) == static_cast<std::uint64_t>(map.keyframes[2].time.nanoseconds()));
        CHECK(u32(block + 4 * 72 + 12) == 0);  // keyframe 4 has no scan
        CHECK(load_as<double>(bytes.data() + block + 2 * 72 + 16) == 2.0);
        CHECK(load_as<double>(bytes.data() + block + 2 * 72 + 16 + 6 * 8) == 0.6);  // w of the quaternion
      }
      if (type == 0x8006) CHECK(load_as<std::int32_t>(bytes.data() + block + 376 + 12) == 0);  // led to by closure 0
      if (type == 0x8004 && found[type] == 1) {
        std::string scan = file.substr(payload, stored);
        if (u32(at + 8) == 1) {
          scan.resize(raw);
          REQUIRE(ZSTD_decompress(scan.data(), raw, file.data() + payload, stored) == raw);
        }
        const auto unsigned_at = [&](std::size_t i) -> unsigned { return static_cast<unsigned char>(scan[i]); };
        const std::size_t n = map.keyframes[0].cloud.size();
        REQUIRE(scan.size() == 32 + 6 * n);
        for (std::size_t axis = 0; axis < 3; ++axis) {
          std::uint16_t number = 0;
          for (std::size_t i = 0; i < n; ++i) {
            const unsigned code = unsigned_at(32 + 2 * n * axis + i) | unsigned_at(32 + 2 * n * axis + n + i) << 8;
            const unsigned difference = code % 2 == 0 ? code / 2 : ~(code / 2);
            number = static_cast<std::uint16_t>(number + difference);
            CHECK(map.keyframes[0].cloud.load()->positions[i][static_cast<Eigen::Index>(axis)] ==
                  static_cast<float>(static_cast<std::int16_t>(number) * 0.01));
          }
        }
      }
      at = payload + space;
    }
    const std::map<unsigned, int> expected = {{0x8001, 1}, {0x8002, 2}, {0x8003, 1}, {0x8004, 4}, {0x8005, 1},
                                              {0x8006, 1}, {7, 1},      {0x8008, 1}, {0x8009, 1}, {0x800a, 1},
                                              {11, 1},     {0x800c, 1}, {0x123, 1}};
    CHECK(found == expected);
    CHECK(u64(file.size() - 64 + 8) == file.size());
    CHECK(u16(u64(file.size() - 64) + 4) == 11);
  }

  TEST_CASE("a map that was saved and loaded has the same optimum") {
    const TemporaryFolder folder;
    const SlamMap map = ring();
    save_map(folder / "a", map);
    const std::vector<SE3d> before = optimum(map), after = optimum(load_map(folder / "a").map);
    double moved = 0;
    for (std::size_t i = 0; i < before.size(); ++i) {
      CHECK(before[i].local(after[i]).norm() < 1e-9);
      moved = std::max(moved, before[i].local(map.keyframes[i].T_map_body).norm());
    }
    CHECK(moved > 0.01);  // there was something to optimize
  }

  TEST_CASE("unknown chunks are kept, unless the map would be wrong without them") {
    const TemporaryFolder folder;
    const std::vector<UnknownChunk> unknown = {{0x0123, 7, 42, 5, 1 << 20, Bytes(100, std::byte{9})},
                                               {0x7fff, 1, 0, 0, 0, {}}};
    save_map(folder / "a", random_map(4, 5), {.unknown = unknown});
    const LoadedMap loaded = load_map(folder / "a");
    CHECK(loaded.unknown == unknown);
    CHECK(loaded.report.unknown_chunks == 2);
    CHECK(loaded.report.complete);
    save_map(folder / "b", loaded);
    CHECK(read_bytes(folder / "a") == read_bytes(folder / "b"));
    rewrite(folder / "a", folder / "c", [](std::vector<Chunk>& chunks) {
      for (Chunk& chunk : chunks)
        if (chunk.header.type == 0x0123) chunk.header.type = 0x8123;
    });
    const std::string error = io_error([&] { return load_map(folder / "c", {.recover = true}); });
    CHECK(says(error, "without which the map would be wrong"));
    CHECK(says(error, "newer version"));
    CHECK_THROWS_AS(save_map(folder / "d", SlamMap{}, {.unknown = {{0x8123, 1, 0, 0, 0, {}}}}), std::invalid_argument);
  }

  TEST_CASE("a higher minor is read, a higher major and unknown flags name what is needed") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(4, 5);
    save_map(folder / "a", map);
    write_bytes(folder / "minor", with_header(folder / "a", 10, chainslam::detail::map_minor + 1));
    const LoadedMap loaded = load_map(folder / "minor");
    CHECK(loaded.report.format_minor == chainslam::detail::map_minor + 1);
    CHECK(same_map(loaded.map, map));
    write_bytes(folder / "major", with_header(folder / "a", 8, 2));
    CHECK(says(io_error([&] { return load_map(folder / "major", {.recover = true}); }),
               "format 2." + std::to_string(chainslam::detail::map_minor)));
    write_bytes(folder / "flags", with_header(folder / "a", 24, 1));
    CHECK(says(io_error([&] { return load_map(folder / "flags", {.recover = true}); }), "flags 1"));
  }

  TEST_CASE("records that grew at their end are read, and it is said that they did") {
    const TemporaryFolder folder;
    const SlamMap map = random_map(4, 12);
    save_map(folder / "a", map);
    rewrite(folder / "a", folder / "b", [](std::vector<Chunk>& chunks) {
      for (Chunk& chunk : chunks) {
        if (chunk.is(ChunkType::session)) chunk.payload.resize(chunk.payload.size() + 24);
        if (chunk.is(ChunkType::odometry)) resize_records(chunk, 360);
      }
    });
    const LoadedMap loaded = load_map(folder / "b");
    CHECK(loaded.report.complete);
    CHECK(loaded.report.newer_fields);
    CHECK(same_map(loaded.map, map));
  }

  TEST_CASE("what breaks the rules under right checksums is refused by chunk, record and field") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    CHECK(says(after_change(ChunkType::keyframes, put(16 + 72 * 2 + 16, nan)), "record 2, T_odom_body"));
    CHECK(says(after_change(ChunkType::keyframes, put(16 + 72 * 2 + 16 + 48, 3.0)), "a quaternion of length"));
    CHECK(says(after_change(ChunkType::keyframes, put(16 + 72 * 2, std::int64_t{0})), "record 2, time"));
    CHECK(says(after_change(ChunkType::keyframes, put(16 + 72 * 2 + 8, 1)), "record 2, session"));
    CHECK(says(after_change(ChunkType::keyframes, put(0, 1)), "record 0, number"));
    CHECK(says(after_change(ChunkType::keyframes, put(4, 71)), "record size"));
    CHECK(says(after_change(ChunkType::keyframes, put(4, -1)), "record size"));
    CHECK(says(after_change(ChunkType::keyframes, [](Chunk& chunk) { chunk.payload.resize(7); }), "payload"));
    CHECK(says(after_change(ChunkType::session, put(12, 100'000)), "name"));
    CHECK(says(after_change(ChunkType::session, put(8, 5)), "session 0, frame"));
    CHECK(says(after_change(ChunkType::odometry, put(16 + 4, 12)), "record 0, to"));
    CHECK(says(after_change(ChunkType::odometry, put(16 + 4, 12)), "12, where there are 12 keyframes"));
    CHECK(says(after_change(ChunkType::closures, put(16 + 8, std::uint16_t{3})), "record 0, kind"));
    CHECK(says(after_change(ChunkType::closures, put(16 + 10, std::uint16_t{10})), "record 0, verdict"));
    CHECK(says(after_change(ChunkType::closures, put(16 + 12, 5)), "cause"));
    CHECK(says(after_change(ChunkType::gnss, put(16 + 4, 6)), "quality"));
    CHECK(says(after_change(ChunkType::gnss, put(16 + 40, -1.0)), "positive semi-definite"));
    CHECK(says(after_change(ChunkType::poses, put(0, 1)), "record 11, keyframe"));
    CHECK(says(after_change(ChunkType::poses, put(0, std::numeric_limits<Index>::max())), "first record"));
    CHECK(says(after_change(ChunkType::commit, put(4, 13)), "keyframes"));
    CHECK(says(after_change(ChunkType::keyframes, [](Chunk& chunk) { chunk.header.raw_bytes = 1ULL << 60; }),
               "raw bytes"));
    CHECK(says(after_change(ChunkType::keyframes, [](Chunk& chunk) { chunk.header.codec = 1; }), "codec"));
  }

  TEST_CASE("scans that lie about their size take no memory for it") {
    const auto as_raw = [](Chunk& chunk) {
      if (chunk.header.codec == RawCodec::id) return;
      Bytes raw(chunk.header.raw_bytes);
      REQUIRE(ZstdCodec{}.decompress(chunk.payload, raw));
      chunk.payload = raw;
      chunk.header.codec = RawCodec::id;
    };
    const auto changed = [&](auto change) {
      return after_change(ChunkType::scan, [&](Chunk& chunk) {
        as_raw(chunk);
        change(chunk);
      });
    };
    CHECK(changed([](Chunk&) {}).empty());
    CHECK(says(changed(put(8, 0xffff'ffffU)), "points"));
    CHECK(says(changed(put(0, 5)), "has it already"));
    CHECK(says(changed(put(0, 99)), "keyframe"));
    CHECK(says(changed(put(4, 2)), "encoding"));
    CHECK(says(changed(put(12, 8)), "encoding"));
    CHECK(says(changed(put(16, 0.0)), "step"));
    CHECK(says(changed([](Chunk& chunk) { chunk.header.version = 2; }), "version"));
    CHECK(says(changed([](Chunk& chunk) { chunk.payload.resize(31); }), "payload"));
    CHECK(says(changed([](Chunk& chunk) {
                 chunk.payload = ZstdCodec{}.compress(Bytes(1 << 20));
                 chunk.header.codec = ZstdCodec::id;
                 chunk.header.raw_bytes = 1 << 20;
               }),
               "raw bytes"));
    CHECK(says(changed([](Chunk& chunk) {
                 chunk.payload = ZstdCodec{}.compress(chunk.payload);
                 chunk.header.codec = ZstdCodec::id;
                 chunk.header.raw_bytes += 1;
               }),
               "does not unpack"));
  }

  TEST_CASE("scans that pack all too well are kept unpacked, so that a file's size bounds what opening it takes") {
    SlamMap map = random_map(4, 2);
    PointCloud<float> wall;
    for (int x = 0; x < 100; ++x)
      for (int y = 0; y < 100; ++y)
        wall.positions.emplace_back(0.05F * static_cast<float>(x), 0.05F * static_cast<float>(y), 1);
    map.keyframes[0].cloud = std::make_shared<const PointCloud<float>>(quantized(wall));
    map.keyframes[1].cloud.reset();
    const TemporaryFolder folder;
    save_map(folder / "a", map);
    const LoadedMap loaded = load_map(folder / "a");
    CHECK(same_map(loaded.map, map));
    for (const MapFileShare& share : loaded.report.shares) CHECK(share.raw_bytes <= 6 * share.bytes);
    CHECK(std::filesystem::file_size(folder / "a") > 60'000);
  }

  TEST_CASE("an index of another file is refused") {
    const TemporaryFolder folder;
    save_map(folder / "a", random_map(4, 5));
    std::string text = read_bytes(folder / "a");
    const chainslam::detail::MapFileReader file(folder / "a");
    const auto& index = file.chunks()[file.chunks().size() - 2];
    Bytes payload = *file.stored_payload(file.chunks().size() - 2);
    payload[0] = std::byte{1};
    Bytes chunk;
    chainslam::detail::append_chunk(chunk, index.header, payload);
    text.replace(index.offset, chunk.size(), reinterpret_cast<const char*>(chunk.data()), chunk.size());
    write_bytes(folder / "b", text);
    CHECK(says(io_error([&] { return load_map(folder / "b"); }), "an index that is not of this file"));
  }
}

}  // namespace chainslam::test
