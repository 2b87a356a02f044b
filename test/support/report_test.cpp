#include "support/report.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/random.hpp"
#include "support/count_text.hpp"
#include "support/encoding.hpp"
#include "support/map_picture.hpp"
#include "support/plot.hpp"

namespace chainslam::support {
namespace {

using test::count;

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

std::string base64_of(const std::string& text) { return base64(std::as_bytes(std::span(text))); }

std::string hex_of(const std::string& text) {
  std::string result;
  for (const std::uint8_t byte : sha256(text)) {
    result += "0123456789abcdef"[byte >> 4];
    result += "0123456789abcdef"[byte & 15];
  }
  return result;
}

std::string between(const std::string& text, const std::string& open, const std::string& close) {
  const std::size_t begin = text.find(open);
  REQUIRE(begin != std::string::npos);
  const std::size_t end = text.find(close, begin + open.size());
  REQUIRE(end != std::string::npos);
  return text.substr(begin + open.size(), end - begin - open.size());
}

std::string content_of(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// A folder that goes with its test, and a stand-in for three.js in it.
class Folder {
 public:
  Folder() : path_(std::filesystem::temp_directory_path() / "chainslam_report_test") {
    std::filesystem::create_directories(path_);
    std::ofstream(three_js()) << three_text;
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  static constexpr const char* three_text = "var THREE = {REVISION: '111'};";
  [[nodiscard]] std::filesystem::path three_js() const { return path_ / "three.min.js"; }
  [[nodiscard]] std::filesystem::path operator/(const char* name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// Two sessions round a square with a wall beside it.
ReportData square_town() {
  Rng rng(1);
  ReportData data{.title = "Square <script>alert('x')</script>", .subtitle = "two \"drives\" & a town"};
  for (int s = 0; s < 2; ++s) {
    ReportSession session{.name = s == 0 ? "first" : "second </script><img src=x onerror=alert(1)>"};
    for (int i = 0; i < 40; ++i) {
      const double angle = 0.1 * i;
      session.times.push_back(0.5 * i);
      session.optimized.emplace_back(50 * std::cos(angle), 40 * std::sin(angle), 1.0);
      session.odometry.emplace_back(50 * std::cos(angle) + 0.01 * i, 40 * std::sin(angle), 1.0);
      session.truth.emplace_back(50 * std::cos(angle), 40 * std::sin(angle), 1.1);
    }
    data.sessions.push_back(session);
  }
  for (int i = 0; i < 20'000; ++i) {
    data.points.emplace_back(static_cast<float>(rng.uniform(-60, 60)), static_cast<float>(rng.uniform(-50, 50)), 0.0F);
    data.points.emplace_back(30.0F, static_cast<float>(rng.uniform(-50, 50)), static_cast<float>(rng.uniform(0, 8)));
    data.point_sessions.insert(data.point_sessions.end(), {0, 1});
  }
  data.closures = {{.from = 0, .to = 40, .kind = ClosureKind::merge, .score = 0.01},
                   {.from = 3, .to = 43, .kind = ClosureKind::direct, .score = 0.04},
                   {.from = 5, .to = 43, .kind = ClosureKind::chained, .score = 0.09}};
  data.refusals = {{.reason = "high residual", .count = 7},
                   {.reason = "high residual", .count = 5, .kind = ClosureKind::chained},
                   {.reason = "low fitness", .count = 2, .kind = ClosureKind::merge}};
  data.components = {{.keyframes = {3, 5, 43}, .sessions = {0, 1}, .closures = 2},
                     {.keyframes = {0, 40}, .sessions = {0, 1}, .closures = 1}};
  data.tables = {{.title = "Errors <i>", .heads = {"", "RMS"}, .rows = {{"all", "0.1 m"}}}};
  data.figures = {{.label = "Keyframes", .value = "80", .note = ""}};
  data.summary = {{"Preset", "best"}};
  data.warnings = {"gap of 2 s <b>here</b>"};
  data.stages = {{.stage = "odometry", .count = 80, .total = 4.0, .p50 = 0.05, .p99 = 0.2, .max = 1.5}};
  data.plots = error_plots(data.sessions);
  data.plots.insert(data.plots.begin(), speed_plot(data.sessions));
  return data;
}

TEST_SUITE("support/encoding") {
  TEST_CASE("base64 agrees with RFC 4648, section 10") {
    CHECK(base64_of("").empty());
    CHECK(base64_of("f") == "Zg==");
    CHECK(base64_of("fo") == "Zm8=");
    CHECK(base64_of("foobar") == "Zm9vYmFy");
    CHECK(base64_of("\xff\xfe\xfd") == "//79");
  }

  TEST_CASE("SHA-256 agrees with the examples of NIST and with lengths round the block") {
    CHECK(hex_of("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    CHECK(hex_of("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    CHECK(hex_of("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq") ==
          "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    CHECK(hex_of(std::string(1'000'000, 'a')) == "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  }

  TEST_CASE("escaped text opens no tag, entity or quote") {
    CHECK(escape_html("a\x1b[2J\xff\n") == "a\\x1B[2J\\xFF\n");
    CHECK(escape_html("<a href=\"x\" id='y'>&amp;") == "&lt;a href=&quot;x&quot; id=&#39;y&#39;&gt;&amp;amp;");
  }
}

TEST_SUITE("support/plot") {
  TEST_CASE("ticks are round and inside") {
    CHECK(axis_ticks(0.0, 10.0, 5) == std::vector<double>{0, 2, 4, 6, 8, 10});
    CHECK(axis_ticks(-0.3, 1.1, 3) == std::vector<double>{0, 0.5, 1});
    CHECK(axis_ticks(1e9, 1e9 + 3, 3).size() == 4);
  }

  TEST_CASE("what is not finite is left out, and long series keep their extremes") {
    ReportSeries series{.name = "x"};
    for (int i = 0; i < 100'000; ++i) {
      series.x.push_back(i);
      series.y.push_back(i == 54'321 ? 99.0 : (i % 1000 == 0 ? not_a_number : 1.0));
    }
    const PlotDrawing drawing = draw_plot({.title = "t", .series = {series}}, 0);
    REQUIRE(drawing.series.size() == 1);
    CHECK(drawing.series[0].x.size() <= 1500);
    CHECK(std::ranges::count(drawing.series[0].y, 99.0) == 1);
    CHECK(drawing.max_y > 99.0);
    CHECK(std::ranges::is_sorted(drawing.series[0].x));
    CHECK(drawing.html.find("nan") == std::string::npos);
  }

  TEST_CASE("empty, constant and single values draw") {
    for (const std::vector<double>& values : {std::vector<double>{}, {3.0}, {3.0, 3.0}}) {
      const PlotDrawing drawing = draw_plot({.title = "t", .series = {{.name = "s", .x = values, .y = values}}}, 3);
      CHECK(drawing.html.find("data-plot=\"3\"") != std::string::npos);
      CHECK(drawing.html.find("nan") == std::string::npos);
      CHECK(drawing.max_x > drawing.min_x);
      CHECK(drawing.max_y > drawing.min_y);
    }
  }
}

TEST_SUITE("support/map_picture") {
  TEST_CASE("the view holds all keyframes, and far points do not shrink it") {
    ReportData data = square_town();
    for (int i = 0; i < 100; ++i) data.points.emplace_back(1e5F, 1e5F, 0.0F);
    data.points.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F);
    const MapView view = view_of(data);
    CHECK(view.min_x < -50);
    CHECK(view.max_x > 50);
    CHECK(view.width() < 140);
    CHECK(view.height() < 130);
    const MapView nothing = view_of({});
    CHECK(nothing.width() > 0);
    CHECK(nothing.height() > 0);
  }

  TEST_CASE("walls are stronger than ground, and where nothing is there is nothing") {
    const ReportData data = square_town();
    const MapView view{-70, -60, 70, 60};
    const MapRaster raster = rasterize(data, view, 140);
    REQUIRE(raster.width == 140);
    REQUIRE(raster.height == 120);
    CHECK(int{raster.at(100, 60)} > 200);  // x in [30, 31), where the wall is
    CHECK(int{raster.at(80, 60)} < 80);
    CHECK(int{raster.at(5, 60)} == 0);
  }

  TEST_CASE("scale bars are round and fit into a fifth") {
    CHECK(scale_bar_length(100) == 20);
    CHECK(scale_bar_length(99) == 10);
    CHECK(scale_bar_length(5001) == 1000);
    CHECK(scale_bar_length(300) == 50);
  }

  TEST_CASE("the file is a PNG of the size asked for") {
    const Folder folder;
    write_map_picture(folder / "map.png", square_town(), {.largest_side = 256, .dark = false});
    const std::string bytes = content_of(folder / "map.png");
    REQUIRE(bytes.size() > 1000);
    CHECK(bytes.substr(0, 8) == "\x89PNG\r\n\x1a\n");
    CHECK(bytes.substr(12, 4) == "IHDR");
    CHECK(int{static_cast<unsigned char>(bytes[18])} * 256 + int{static_cast<unsigned char>(bytes[19])} == 256);
    CHECK_THROWS_AS(write_map_picture(folder / "missing/map.png", square_town()), IoError);
  }

  TEST_CASE("an empty map is a picture too") {
    const Folder folder;
    CHECK_NOTHROW(write_map_picture(folder / "map.png", {}, {.largest_side = 64}));
  }
}

TEST_SUITE("support/report") {
  TEST_CASE("the page has a title, headings, tables, plots and the data of the view") {
    const Folder folder;
    const std::string html = report_html(square_town(), {.three_js = folder.three_js()});
    CHECK(html.starts_with("<!DOCTYPE html>"));
    for (const std::string part : {"<title>Mapping report: Square &lt;script&gt;",
                                   "<h2>Map in 3-D</h2>",
                                   "<h2>Map from above</h2>",
                                   "<h2>Over time</h2>",
                                   "Speed between keyframes",
                                   "Distance from the truth",
                                   "Closures accepted",
                                   "high residual",
                                   "Candidates refused",
                                   "<td class=\"n\">12</td>",
                                   "Components of the adjacency graph",
                                   "Before and after",
                                   "Errors &lt;i&gt;",
                                   "odometry, placed by the merge",
                                   "Time by stage",
                                   "50.00 ms",
                                   "1.50 s",
                                   "0.300 m",
                                   "two &quot;drives&quot; &amp; a town",
                                   "gap of 2 s &lt;b&gt;here",
                                   "data:image/png;base64,"}) {
      CAPTURE(part);
      CHECK(html.find(part) != std::string::npos);
    }
    CHECK(count(html, "<div class=\"plot\"") == 4);  // speed, errors of both and of each
    CHECK(count(html, "class=\"closures ") == 6);    // in the plan, and in that after the closures
    CHECK(count(html, "data-switch=\"") == 7);       // trajectories, odometry, truth, three kinds, components
    CHECK(count(html, "data-session=\"") == 2);
    CHECK(count(html, "class=\"component k") == 2);
    const std::string paths = between(html, "id=\"paths\">", "</script>");
    CHECK(paths.size() == (6 * 40 * 3 * sizeof(float) + 2) / 3 * 4);
    const std::string closures = between(html, "id=\"closures\">", "</script>");
    CHECK(closures.size() == (3 * 3 * sizeof(std::int32_t) + 2) / 3 * 4);
  }

  TEST_CASE("the verdict stands before all figures, and stretches where scans were lost are in the plan") {
    const Folder folder;
    ReportData data = square_town();
    CHECK(count(report_html(data, {.three_js = folder.three_js()}), "\"verdict") == 0);
    data.verdict = "failed: missed <max_lost_share>";
    data.failed = true;
    data.sessions[0].lost = {{{0, 0, 0}, {1, 0, 0}, {2, 1, 0}}, {{5, 5, 0}, {6, 5, 0}}};
    const std::string html = report_html(data, {.three_js = folder.three_js()});
    const auto verdict = html.find("<p class=\"verdict failed\">failed: missed &lt;max_lost_share&gt;");
    REQUIRE(verdict != std::string::npos);
    CHECK(verdict < html.find("<dl class=\"figures\">"));
    CHECK(verdict < html.find("two &quot;drives&quot;"));
    CHECK(count(html, "class=\"path lost\"") == 2);
    CHECK(count(html, "<circle class=\"lost\"") == 2);
    CHECK(count(html, "data-switch=\"lost\"") == 1);
  }

  TEST_CASE("what is asked first stands before all figures, with links to the files next to the page") {
    const Folder folder;
    ReportData data = square_town();
    CHECK(count(report_html(data, {.three_js = folder.three_js()}), "<dl class=\"answers\">") == 0);
    data.answers = {{"Merged", "all 2 <sessions>"}};
    data.folder = "/maps/a & b";
    data.files = {{"map.ply", "point cloud"}, {"frames.csv"}};
    const std::string html = report_html(data, {.three_js = folder.three_js()});
    CHECK(html.find("<dl class=\"answers\">") < html.find("<dl class=\"figures\">"));
    CHECK(between(html, "<dl class=\"answers\">", "</dl>") ==
          "<div><dt>Merged</dt><dd>all 2 &lt;sessions&gt;</dd></div><div><dt>Files</dt><dd>in /maps/a &amp; b: <a "
          "href=\"map.ply\">map.ply</a> (point cloud), <a href=\"frames.csv\">frames.csv</a></dd></div>");
  }

  TEST_CASE("columns with long cells are words, others numbers") {
    const Folder folder;
    ReportData data = square_town();
    data.tables = {{.title = "t",
                    .heads = {"", "note", "count"},
                    .rows = {{"a", "more than two dozen letters", "1"}, {"b", "short", "2"}}}};
    const std::string html = report_html(data, {.three_js = folder.three_js()});
    CHECK(html.find("<th class=\"words\">note</th><th class=\"n\">count</th>") != std::string::npos);
    CHECK(html.find("<td class=\"words\">short</td><td class=\"n\">2</td>") != std::string::npos);
  }

  TEST_CASE("names cannot become markup") {
    const Folder folder;
    const std::string html = report_html(square_town(), {.three_js = folder.three_js()});
    CHECK(html.find("<script>alert") == std::string::npos);
    CHECK(html.find("<img") == std::string::npos);
    CHECK(html.find("<b>") == std::string::npos);
    CHECK(count(html, "<script") == 7);  // five blocks of data, three.js, our own
    CHECK(count(html, "</script>") == 7);
  }

  TEST_CASE("the policy allows the page's own scripts and style by their hashes, and nothing else") {
    const Folder folder;
    const std::string html = report_html(square_town(), {.three_js = folder.three_js()});
    const std::string policy = between(html, "Content-Security-Policy\" content=\"", "\"");
    CHECK(policy.starts_with("default-src 'none'; "));
    CHECK(policy.find("unsafe") == std::string::npos);
    const auto hash = [](const std::string& text) {
      const auto digest = sha256(text);
      return "'sha256-" + base64(std::as_bytes(std::span(digest))) + "'";
    };
    CHECK(policy.find(hash(between(html, "<style>", "</style>"))) != std::string::npos);
    CHECK(policy.find(hash(Folder::three_text)) != std::string::npos);
    const std::size_t last = html.rfind("<script>") + 8;
    CHECK(policy.find(hash(html.substr(last, html.rfind("</script>") - last))) != std::string::npos);
  }

  TEST_CASE("nothing in the page points to a network") {
    const Folder folder;
    ReportData data = square_town();
    data.sessions[1].name = "second";
    data.plots = {speed_plot(data.sessions)};
    const std::string html = report_html(data, {.three_js = folder.three_js()});
    for (const std::string part : {"http:", "https:", " src=", "@import", "url("}) {
      CAPTURE(part);
      CHECK(html.find(part) == std::string::npos);
    }
    CHECK(count(html, " style=\"") == 0);  // the policy would refuse it
  }

  TEST_CASE("points are thinned to the number asked for and the page stays small") {
    const Folder folder;
    const ReportData data = square_town();
    const std::string html = report_html(data, {.three_js = folder.three_js(), .max_points = 5000});
    const std::size_t bytes = between(html, "id=\"points\">", "</script>").size() / 4 * 3;
    CHECK(bytes <= 5000 * 6);
    CHECK(bytes > 2000 * 6);
    CHECK(html.size() < 600'000);
  }

  TEST_CASE("a page of nothing is a page") {
    const Folder folder;
    const std::string html = report_html({.title = "empty"}, {.three_js = folder.three_js()});
    CHECK(html.find("<h1>empty</h1>") != std::string::npos);
    CHECK(html.find("<canvas") == std::string::npos);
  }

  TEST_CASE("positions that are not finite draw nothing") {
    const Folder folder;
    ReportData data = square_town();
    data.sessions[0].optimized[3].x() = not_a_number;
    data.points[7].y() = std::numeric_limits<float>::infinity();
    const std::string html = report_html(data, {.three_js = folder.three_js()});
    const std::string svg = between(html, "preserveAspectRatio", "</svg>");
    const std::string drawing = svg.substr(svg.find("<polyline"));  // behind the picture's base64
    CHECK(drawing.find("nan") == std::string::npos);
    CHECK(drawing.find("–") == std::string::npos);
  }

  TEST_CASE("a missing three.js is an error that says what to install") {
    CHECK_THROWS_WITH_AS(
        static_cast<void>(report_html(square_town(), {.three_js = "/nowhere/three.min.js"})),
        "/nowhere/three.min.js\n  found: no three.js there, which the report's 3-D view needs\n  do: install "
        "Debian's libjs-three, or name the folder's three.min.js of release 111",
        IoError);
    const Folder folder;
    std::ofstream(folder.three_js()) << "var x = '</script>';";
    CHECK_THROWS_AS(static_cast<void>(report_html(square_town(), {.three_js = folder.three_js()})), IoError);
  }

  TEST_CASE("data that does not fit together is refused") {
    const Folder folder;
    const ReportOptions options{.three_js = folder.three_js()};
    ReportData data = square_town();
    data.sessions[1].truth.pop_back();
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
    data = square_town();
    data.closures[0].to = 80;
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
    data = square_town();
    data.components[1].keyframes.push_back(80);
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
    data = square_town();
    data.components[0].sessions.clear();
    data.components[0].keyframes.clear();
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
    data = square_town();
    data.sessions[1].frame = 2;
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
    data = square_town();
    data.point_sessions.pop_back();
    CHECK_THROWS_AS(static_cast<void>(report_html(data, options)), std::invalid_argument);
  }

  TEST_CASE("the file is what report_html gives") {
    const Folder folder;
    const ReportData data = square_town();
    write_report(folder / "report.html", data, {.three_js = folder.three_js()});
    CHECK(content_of(folder / "report.html") == report_html(data, {.three_js = folder.three_js()}));
  }
}

SE3d at(double x, double y = 0) { return SE3d(SO3d(), Eigen::Vector3d(x, y, 0)); }

Session session(Index id, const char* name, Index first, Index keyframes, Index frame) {
  Session result;
  result.id = SessionId{id};
  result.name = name;
  result.first_keyframe = first;
  result.keyframes = keyframes;
  result.frame = SessionId{frame};
  return result;
}

LoopClosure closure(Index from, Index to, ClosureKind kind, const SE3d& T_from_to) {
  LoopClosure result;
  result.from = KeyframeId{from};
  result.to = KeyframeId{to};
  result.kind = kind;
  result.T_from_to = T_from_to;
  result.sqrt_information.setIdentity();
  return result;
}

/// Three sessions of four keyframes, 10 m apart along x. The second was merged into the first, 2 m beside it, with
/// odometry that is 1 m too long between keyframes; the third was not.
SlamMap three_sessions() {
  SlamMap map;
  map.sessions = {session(0, "a", 0, 4, 0), session(1, "b", 4, 4, 0), session(2, "c", 8, 4, 2)};
  for (Index i = 0; i < 12; ++i) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{i};
    keyframe.session = SessionId{i / 4};
    keyframe.time = Timestamp::from_seconds(i);
    keyframe.T_map_body = at(10.0 * (i % 4), i / 4 == 1 ? 2 : 0);
    keyframe.T_odom_body = at((i / 4 == 1 ? 11.0 : 10.0) * (i % 4));
    map.keyframes.push_back(keyframe);
  }
  map.closures = {closure(2, 6, ClosureKind::merge, at(0, 2)), closure(2, 7, ClosureKind::direct, at(10, 2)),
                  closure(0, 4, ClosureKind::direct, at(0, 2)), closure(3, 7, ClosureKind::chained, at(0, 2))};
  map.refusals = {closure(1, 5, ClosureKind::chained, at(0)), closure(1, 6, ClosureKind::chained, at(0)),
                  closure(1, 6, ClosureKind::merge, at(0))};
  for (LoopClosure& refusal : map.refusals) refusal.verdict = ClosureVerdict::high_residual;
  map.refusals.back().verdict = ClosureVerdict::unconfirmed;
  return map;
}

TEST_SUITE("support/report_data") {
  TEST_CASE(
      "where scans were lost the path of odometry, corrected at the keyframes, is drawn; their matches are plotted") {
    SlamMap map = three_sessions();
    for (int i = 0; i <= 12; ++i) {  // session b, four frames between two keyframes; odometry is 1 m in 11 too long
      FrameRecord frame;
      frame.session = SessionId{1};
      frame.time = Timestamp::from_seconds(4 + 0.25 * i);
      frame.T_odom_body = at(2.75 * i);
      frame.health = {.points = 200, .matches = 150, .iterations = 3};
      if (i == 6 || i == 7) frame.health = {.status = FrameStatus::lost, .points = 200, .matches = 10, .iterations = 3};
      map.frames.push_back(frame);
    }
    const ReportData data = report_data(map, 0.5);
    CHECK(data.sessions[0].lost.empty());
    REQUIRE(data.sessions[1].lost.size() == 1);
    const auto& stretch = data.sessions[1].lost[0];
    REQUIRE(stretch.size() == 4);  // with a frame before and after
    for (std::size_t i = 0; i < 4; ++i) {
      CHECK(stretch[i].x() == doctest::Approx(2.5 * static_cast<double>(i + 5)));
      CHECK(stretch[i].y() == doctest::Approx(2));
    }
    const ReportPlot plot = match_plot(map);
    REQUIRE(plot.series.size() == 1);
    CHECK(plot.series[0].name == "b");
    CHECK(plot.series[0].y[5] == doctest::Approx(75));
    CHECK(plot.series[0].y[6] == doctest::Approx(5));
  }

  TEST_CASE("odometry lies where its merge put it, and drifts from there") {
    const SlamMap map = three_sessions();
    const SE3d T_map_odom = odometry_placement(map, map.sessions[1]);
    CHECK(T_map_odom.translation().isApprox(Eigen::Vector3d(-2, 2, 0)));  // at keyframe 6, two odd metres back
    const ReportData data = report_data(map, 0.5);
    CHECK(data.sessions[1].odometry[2].isApprox(data.sessions[1].optimized[2]));
    CHECK((data.sessions[1].odometry[3] - data.sessions[1].optimized[3]).norm() == doctest::Approx(1));
    CHECK(data.sessions[0].odometry[3].isApprox(data.sessions[0].optimized[3]));
  }

  TEST_CASE("a session is placed by a later one's merge with it, if that is what joined it") {
    SlamMap map = three_sessions();
    map.closures = {closure(6, 8, ClosureKind::merge, at(5, 1))};
    const SE3d T_map_odom = odometry_placement(map, map.sessions[1]);
    CHECK((T_map_odom * map.keyframes[6].T_odom_body).translation().isApprox(Eigen::Vector3d(-5, -1, 0)));
  }

  TEST_CASE("frames that no merge joined are drawn side by side") {
    const ReportData data = report_data(three_sessions(), 0.5);
    CHECK(data.sessions[0].offset.isZero());
    CHECK(data.sessions[1].offset.isZero());
    CHECK(data.sessions[1].frame == 0);
    CHECK(data.sessions[2].frame == 2);
    CHECK(data.sessions[2].offset.x() > 100);
    CHECK(data.sessions[2].optimized[0].isApprox(data.sessions[2].offset));
  }

  TEST_CASE("components join what closures that are factors connect, the largest first") {
    SlamMap map = three_sessions();
    const auto components = adjacency_components(map);
    REQUIRE(components.size() == 2);
    CHECK(components[0].keyframes == std::vector<Index>{2, 3, 6, 7});
    CHECK(components[0].sessions == std::vector<Index>{0, 1});
    CHECK(components[0].closures == 3);
    CHECK(components[1].keyframes == std::vector<Index>{0, 4});
    map.closures[1].sqrt_information.setZero();
    CHECK(adjacency_components(map).size() == 3);
    CHECK(adjacency_components({}).empty());
  }

  TEST_CASE("refusals are counted by reason and kind") {
    const ReportData data = report_data(three_sessions(), 0.5);
    REQUIRE(data.refusals.size() == 2);
    CHECK(data.refusals[0].count == 2);
    CHECK(data.refusals[0].kind == ClosureKind::chained);
    CHECK(data.refusals[1].reason == "not confirmed by a second place");
    CHECK(data.refusals[1].kind == ClosureKind::merge);
  }

  TEST_CASE("several sessions with truth have a plot together and one each") {
    std::vector<ReportSession> sessions(2);
    for (std::size_t i = 0; i < 2; ++i)
      sessions[i] = {.name = i == 0 ? "a" : "b",
                     .times = {0},
                     .optimized = {{1, 0, 0}},
                     .odometry = {{0, 2, 0}},
                     .truth = {{0, 0, 0}}};
    const auto plots = error_plots(sessions);
    REQUIRE(plots.size() == 3);
    CHECK(plots[0].series.size() == 2);
    REQUIRE(plots[2].series.size() == 2);
    CHECK(plots[2].series[0].color == 1);
    CHECK(plots[2].series[1].y == std::vector<double>{2});
    CHECK(plots[2].series[1].dashed);
  }

  TEST_CASE("the back end's times are milliseconds, and no keyframe is no line") {
    CHECK(back_end_plot({}).series.empty());
    CHECK(back_end_plot({0.5, 0.001}).series.at(0).y == std::vector<double>{500, 1});
  }

  TEST_CASE("a map's sessions, closures, refusals and points come through") {
    auto cloud = std::make_shared<PointCloud<float>>();
    cloud->positions = {{1, 0, 0}, {1.1F, 0, 0}, {5, 0, 0}, {std::numeric_limits<float>::quiet_NaN(), 0, 0}};
    SlamMap map;
    map.sessions = {session(0, "a", 0, 2, 0), session(1, "b", 2, 1, 0)};
    map.keyframes = {{KeyframeId{0}, SessionId{0}, Timestamp::from_seconds(10), at(100), at(1000), cloud, {}},
                     {KeyframeId{1}, SessionId{0}, Timestamp::from_seconds(12), at(103), at(1004), cloud, {}},
                     {KeyframeId{2}, SessionId{1}, Timestamp::from_seconds(5), at(0), at(1000), nullptr, {}}};
    map.closures = {closure(0, 2, ClosureKind::merge, at(0))};
    map.refusals.resize(3);
    map.refusals[0].verdict = map.refusals[2].verdict = ClosureVerdict::high_residual;
    map.refusals[1].verdict = ClosureVerdict::implausible;

    const ReportData data = report_data(map, 0.5);
    REQUIRE(data.sessions.size() == 2);
    CHECK(data.sessions[0].name == "a");
    CHECK(data.sessions[0].times == std::vector<double>{0, 2});
    CHECK(data.sessions[0].odometry[1].x() == doctest::Approx(1003));
    CHECK(data.sessions[1].optimized.size() == 1);
    REQUIRE(data.closures.size() == 1);
    CHECK(data.closures[0].to == 2);
    CHECK(data.closures[0].kind == ClosureKind::merge);
    REQUIRE(data.refusals.size() == 2);
    CHECK(data.refusals[0].reason == "high residual");
    CHECK(data.refusals[0].count == 2);
    // Points at 1001, 1001.1, 1005 and 1005, 1005.1, 1009: one for each cell of half a metre, from the first keyframe
    // on.
    REQUIRE(data.points.size() == 3);
    CHECK(data.points[0].x() == doctest::Approx(1.0F));
    CHECK(data.points[2].x() == doctest::Approx(9.0F));
    REQUIRE(data.plots.size() == 1);
    REQUIRE(data.plots[0].series.size() == 1);
    CHECK(data.plots[0].series[0].y == std::vector<double>{2.0});
  }

  TEST_CASE("errors are distances from the truth") {
    std::vector<ReportSession> sessions(2);
    sessions[0] = {.name = "a",
                   .times = {0, 1},
                   .optimized = {{0, 0, 0}, {3, 4, 0}},
                   .odometry = {},
                   .truth = {{0, 0, 0}, {0, 0, 0}}};
    const std::vector<ReportPlot> plots = error_plots(sessions);
    REQUIRE(plots.size() == 1);
    REQUIRE(plots[0].series.size() == 1);
    CHECK(plots[0].series[0].y == std::vector<double>{0, 5});
  }
}

}  // namespace
}  // namespace chainslam::support
