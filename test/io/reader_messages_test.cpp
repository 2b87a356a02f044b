#include <doctest/doctest.h>
#include <sys/stat.h>

#include <string>
#include <vector>

#include "chainslam/io/g2o.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "support/files.hpp"
#include "support/source_calls.hpp"

// The messages of this module's readers: what each is about, where, and what helps. A test below finds the places in
// the sources that none of these cases comes from.

namespace chainslam::test {
namespace {

struct MessageCase {
  std::string file;  ///< whose ending says which reader is asked
  std::string bytes;
  std::string place;  ///< "" if the whole file is meant
  std::string found, remedy;
};

void read_by_name(const std::filesystem::path& path) {
  const std::string name = path.filename().string();
  if (name.ends_with(".pcd")) static_cast<void>(read_pcd_file(path));
  if (name.ends_with(".ply")) static_cast<void>(read_ply_file(path));
  if (name.ends_with(".tum")) static_cast<void>(read_tum(path));
  if (name.ends_with(".csv")) static_cast<void>(read_euroc_csv(path));
  if (name.ends_with(".g2o")) static_cast<void>(read_g2o(path));
  if (name.ends_with(".bin")) static_cast<void>(read_kitti_bin(path));
  if (name.ends_with(".txt")) static_cast<void>(read_kitti_poses(path));
}

/// A PCD header; `change` replaces the line that starts with its first word.
std::string pcd_with(const std::string& change, const std::string& body = "") {
  std::string text;
  const std::string keyword = change.substr(0, change.find(' '));
  for (const std::string line :
       {"FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1", "WIDTH 2", "HEIGHT 1", "POINTS 2", "DATA ascii"})
    text += (line.starts_with(keyword + ' ') ? change : line) + '\n';
  return text + body;
}

std::string ply_with(const std::string& format, const std::string& element, const std::string& body = "") {
  return "ply\nformat " + format + " 1.0\n" + element + "end_header\n" + body;
}

std::vector<MessageCase> cases() {
  const std::string copy = "the file was cut short: copy or record it again";
  const std::string damaged = "the file is damaged: copy or record it again";
  const std::string header = "the file was cut short or its header is wrong: copy or record it again";
  const std::string no_pcd = "this is no PCD file, or its header is damaged";
  const std::string no_ply = "this is no PLY file, or its header is damaged";
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
  const std::string compressed = pcd_with("DATA binary_compressed");
  const auto sizes = [](std::uint32_t packed, std::uint32_t plain) { return little(packed) + little(plain); };
  return {
      // Files and lines.
      {"long.tum", std::string((1 << 20) + 1, '1'), "line 1", "a line of more than 1 MiB",
       "this is no text file of the kind asked for"},
      {"a.tum", "1 2 3\n", "line 1, field z", "the end of the line", "check that the line holds all its fields"},
      {"a.tum", "0 0 0 0 0 0 0 1\n1 x 0 0 0 0 0 1\n", "line 2, field x", "'x'", "write a finite number here"},
      {"a.tum", "1 nan 0 0 0 0 0 1\n", "line 1, field x", "'nan'", "write a finite number here"},
      {"a.tum", "1 0,5 0 0 0 0 0 1\n", "line 1, field x", "'0,5'",
       "write decimals with a point and separate fields as the format asks: a comma is read as part of the number"},
      {"a.tum", "soon 0 0 0 0 0 0 1\n", "line 1, field t", "'soon'", "write the time in seconds here"},
      {"a.tum", "1403715524907143168 0 0 0 0 0 0 1\n", "line 1, field t", "'1403715524907143168'",
       "write the time in seconds; this looks like nanoseconds or microseconds"},
      {"a.tum", "1 0 0 0 0 0 0 1 9\n", "line 1, field after the last", "'9'",
       "each line holds eight fields: t x y z qx qy qz qw"},
      {"a.tum", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2, field t",
       "a stamp that is earlier than the one before it", "sort the lines by time"},
      {"a.tum", "1 0 0 0 0 0 0 2\n", "line 1, field qx qy qz qw", "a quaternion of length 2.000000",
       "write a unit quaternion, its parts in the order x y z w"},
      {"a.csv", "1,0,0,0,2,0,0,0\n", "line 1, field qx qy qz qw", "a quaternion of length 2.000000",
       "write a unit quaternion, its parts in the order w x y z"},
      {"a.csv", "1.5,0,0,0,1,0,0,0\n", "line 1, field timestamp", "'1.5'", "write a whole number here"},
      {"a.csv", "9000000000000000000,0,0,0,1,0,0,0\n", "line 1, field timestamp", "a time beyond the year 2115",
       "write nanoseconds since 1970"},
      {"a.csv", "2,0,0,0,1,0,0,0\n1,0,0,0,1,0,0,0\n", "line 2, field timestamp",
       "a stamp that is earlier than the one before it", "sort the lines by time"},
      {"a.txt", "1 0 0 0 0 1 0 0 0 0 1 0 5\n", "line 1, field after the last", "'5'",
       "each line holds twelve numbers, a row-major 3x4 matrix"},
      {"a.txt", "2 0 0 0 0 1 0 0 0 0 1 0\n", "line 1, field r11..r33",
       "a matrix that is no rotation (R^T R differs from I by 3.000000)",
       "write row-major 3x4 poses [R | t] with R orthonormal and right-handed"},
      {"a.bin", std::string(19, 'x'), "byte 16", "3 bytes after the last point",
       "KITTI's scans hold 16 bytes a point (x y z reflectance): the file was cut short or is of another kind"},
      // g2o.
      {"a.g2o", "EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1\n", "line 1, field to", "an edge from a vertex to itself",
       "remove the line"},
      {"a.g2o", "EDGE_SE2 0 1 0 0 0 -1 0 0 1 0 1\n", "line 1, field information", "a negative number on the diagonal",
       "information is positive semi-definite"},
      {"a.g2o", "VERTEX_SE2 7 0 0 0\nVERTEX_SE2 7 0 0 0\n", "line 2, field id", "7 a second time",
       "give each vertex its own id"},
      // PCD.
      {"a.pcd", "FIELDS x y z\n", "the end of the header", "no line that starts with DATA",
       "this is no PCD file, or it was cut short"},
      {"a.pcd", "FELDS x y z\n", "line 1, field keyword", "'FELDS'", no_pcd},
      {"a.pcd", pcd_with("SIZE 4 4"), "line 8", "3 FIELDS, 2 SIZE, 3 TYPE, 3 COUNT",
       "give each field a size, a type and a count"},
      {"a.pcd", "FIELDS x\nSIZE 4\nTYPE F\nDATA ascii\n", "line 4", "neither POINTS nor WIDTH and HEIGHT",
       "state the number of points"},
      {"a.pcd", pcd_with("POINTS 3"), "line 8", "POINTS 3, WIDTH * HEIGHT 2",
       "make POINTS equal to WIDTH * HEIGHT, below 2^31"},
      {"a.pcd", pcd_with("DATA packed"), "line 8", "DATA 'packed'", "use ascii, binary or binary_compressed"},
      {"a.pcd", pcd_with("TYPE F F X"), "line 8", "a field of TYPE 'X' and SIZE 4",
       "use I or U with 1, 2, 4 or 8 bytes, F with 4 or 8"},
      {"a.pcd", pcd_with("COUNT 0 0 0"), "line 4", "COUNT 0", "the header is damaged"},
      {"a.pcd", pcd_with("FIELDS a y z"), "FIELDS", "no fields x, y and z", "write the coordinates under these names"},
      {"a.pcd", pcd_with("DATA ascii", "1 2 3\n    \n    \n"), "line 11", "the end of the file after 1 of 2 points",
       copy},
      {"a.pcd", pcd_with("DATA ascii", "1 2 x\n4 5 6\n"), "line 9, field z", "'x'", "write a number here"},
      {"a.pcd", pcd_with("DATA ascii", "1 2 3 4\n4 5 6\n"), "line 9, field after the last", "'4'",
       "each line holds as many numbers as FIELDS and COUNT ask for"},
      {"a.pcd", pcd_with("DATA binary", std::string(23, '\0')),
       "byte " + std::to_string(pcd_with("DATA binary").size()),
       "23 bytes, where the header promises 2 points of 12 bytes or more", header},
      {"a.pcd", compressed + "1234", "byte " + std::to_string(compressed.size()),
       "the file ends after 4 of 8 bytes of the sizes of the compressed points", copy},
      {"a.pcd", compressed + sizes(4, 25), "byte " + std::to_string(compressed.size() + 8),
       "25 bytes of points, where the header asks for 2 points of 12 bytes", damaged},
      {"a.pcd", compressed + sizes(4, 24) + "12", "byte " + std::to_string(compressed.size() + 8),
       "2 bytes, where the header promises 4 of compressed points", header},
      {"a.pcd", compressed + sizes(4, 24) + "1234", "byte " + std::to_string(compressed.size() + 12),
       "compressed points that do not unpack to their size", damaged},
      {"a.pcd",
       "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1000000\nDATA binary_compressed\n" + sizes(4, 12'000'000) + "1234",
       "byte 81", "4 bytes that claim to unpack to 12000000", damaged + ", or write the points as DATA binary"},
      // PLY.
      {"a.ply", "plx\n", "line 1", "no 'ply'", "this is no PLY file"},
      {"a.ply", "ply\nelement vertex 1\nproperty half x\n", "line 3, field type", "'half'",
       "use char, uchar, short, ushort, int, uint, float or double"},
      {"a.ply", "ply\nproperty float x\n", "line 2, field property", "a property before any element",
       "the header is damaged"},
      {"a.ply", "ply\nelement a 1\nproperty list float float x\n", "line 3, field list length type", "no whole number",
       "the header is damaged"},
      {"a.ply", "ply\nend_header\n", "line 2", "no format line", "the header is damaged"},
      {"a.ply", "ply\nformat text 1.0\n", "line 2, field format", "'text'",
       "use ascii, binary_little_endian or binary_big_endian"},
      {"a.ply", "ply\nelement vertex 2147483648\n", "line 2, field count", "2147483648",
       "elements number 0 to 2^31 - 1: the header is damaged"},
      {"a.ply", "ply\nelements\n", "line 2, field keyword", "'elements'", no_ply},
      {"a.ply", "ply\nformat ascii 1.0\n", "line 2", "no end_header", "this is no PLY file, or it was cut short"},
      {"a.ply", ply_with("ascii", "element vertex 2\n" + xyz, "1 2 3\n"), "line 8",
       "the end of the file within element 'vertex'", copy},
      {"a.ply", ply_with("ascii", "element vertex 1\n" + xyz, "1 2 3 4\n"), "line 8, field after the last", "'4'",
       "each line holds one row of its element"},
      {"a.ply", ply_with("binary_little_endian", "element a 1\nproperty list int uchar b\n", little(std::int32_t{-2})),
       "byte 89", "a list of -2.000000 entries", "the file is damaged"},
      {"a.ply", ply_with("ascii", "element vertex 0\nproperty float x\n"), "element vertex", "no properties x, y and z",
       "write them under these names"},
      {"a.ply", ply_with("ascii", "element face 0\n"), "the header", "no element named vertex",
       "this PLY file holds no points"},
  };
}

}  // namespace

TEST_SUITE("io/messages of readers") {
  TEST_CASE("each message names its file, its place, what was found and what helps") {
    const TemporaryFolder folder;
    for (const MessageCase& one : cases()) {
      CAPTURE(one.found);
      write_bytes(folder / one.file, one.bytes);
      const std::string message = io_error([&] { return read_by_name(folder / one.file), 0; });
      const std::string start =
          (folder / one.file).string() + (one.place.empty() ? "" : ", " + one.place) + "\n  found: ";
      CHECK_MESSAGE(message.starts_with(start), message);
      CHECK_MESSAGE(says(message, one.found), message);
      CHECK_MESSAGE(message.ends_with("\n  do: " + one.remedy), message);
    }
  }

  TEST_CASE("files that cannot be opened, folders and pipes") {
    const TemporaryFolder folder;
    const auto message = [&](const std::filesystem::path& path) {
      return io_error([&] { return read_by_name(path), 0; });
    };
    CHECK(message(folder / "none.tum") ==
          (folder / "none.tum").string() + "\n  found: no such file\n  do: check the path");
    std::filesystem::create_directories(folder / "a.tum");
    CHECK(message(folder / "a.tum") == (folder / "a.tum").string() + "\n  found: a folder\n  do: name the file itself");
    const std::string loop = (folder / "loop.tum").string();
    std::filesystem::create_symlink(loop, loop);
    CHECK(says(message(loop), "found: Too many levels of symbolic links\n  do: check that you may read it"));
    CHECK(says(message("/dev/null/a.tum"), "no such file"));
    write_bytes(folder / "empty.bin", "");
    CHECK(message("/dev/null").empty());
    InputFile device("/dev/zero");
    CHECK(io_error([&] { return device.require(1, "points"), 0; }) ==
          "/dev/zero\n  found: a pipe or a device\n  do: copy it to a plain file first");
  }

  TEST_CASE("no place in the readers that fails is without a case") {
    // The last is a failing disk's, as `every_fault` of the program's tests has it.
    std::string all =
        "no such file|check that you may read it|a folder|a pipe or a device|check the disk; the file could not be "
        "read on|";
    for (const MessageCase& one : cases()) all += one.place + '|' + one.found + '|' + one.remedy + '|';
    for (const char* name :
         {"pcd", "ply", "trajectory_file", "g2o", "input_file", "detail/pose_fields", "detail/point_records"}) {
      const std::string source =
          read_bytes(std::string(CHAINSLAM_SOURCE_DIR) + "/include/chainslam/io/" + name + ".hpp");
      REQUIRE(!source.empty());
      for (const std::string& call : unsaid_calls(source, "fail(", all)) CHECK_MESSAGE(false, name << ": " << call);
    }
    CHECK(unsaid_calls("file.fail(place, \"a message of no case\");", "fail(", all).size() == 1);
  }

  TEST_CASE("no place in map files, journals and results that fails is without a case") {
    // In map_format_test, map_recovery_test, map_archive_test, power_cut_test, atomic_file_test, faults_test,
    // scan_file_test and frame_file_test.
    const std::string all =
        "take a newer version of the program: this one may not know all that the file says|, raw bytes|session |"
        "`chainslam recover` recovers the intact part in a new file|check the path, and that you may read it|not a "
        "plain file (a folder, a pipe or a device)|"
        "a payload that does not unpack to |the end of the file, which was longer before| bytes, which is no map|"
        "no map's mark|bytes that do not match their checksum|byte 8, the file's header|, without which the map would "
        "be "
        "wrong|take a newer version of the program|this one may not know all that the file says| stored ones|the end "
        "of the map, with more behind it|payload|record "
        "size|"
        "first record|number|a text of |first keyframe|session|version|encoding|points|keyframe|, where |closure to "
        "keyframe |scan of keyframe |an index that is not of this file|`chainslam recover` recovers the intact part|no "
        "complete commit|a map that takes |damage that comes and goes| that the journal had already|not a plain "
        "file (a "
        "folder or a device)|creating the file|making the disk keep the file|closing the file|making the disk keep the "
        "folder's entry|giving it its name|something is there already|choose a file's name| is writing this map|what a "
        "run "
        "left that did not finish|locking the file|looking at the file that is there|keeping it as |; what had been "
        "committed is kept: `chainslam recover |record |allow more open files (ulimit -n)|opening it to be read|the "
        "scan of keyframe |frames at byte |check the disk, and that nothing else writes the file|"
        "bytes that have changed since they were read or written|";
    int calls = 0;
    for (const char* name :
         {"detail/map_file_reader", "detail/map_decoder", "map_archive", "input_journal", "atomic_file",
          "detail/partial_file", "detail/final_name", "detail/scan_file", "detail/frame_file"}) {
      const std::string source =
          read_bytes(std::string(CHAINSLAM_SOURCE_DIR) + "/include/chainslam/io/" + name + ".hpp");
      for (const char* function : {"fail(", "throw_output_error("}) {
        calls += static_cast<int>(calls_of(source, function).size());
        for (const std::string& call : unsaid_calls(source, function, all))
          CHECK_MESSAGE(false, std::string(name) << ": " << call);
      }
    }
    CHECK(calls > 50);
  }
}

}  // namespace chainslam::test
