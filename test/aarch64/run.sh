#!/usr/bin/env bash
# Compares what an AArch64 build computes, run by qemu-user, with what the x86-64 build computes: to the last bit.
# usage: test/aarch64/run.sh BUILD-FOLDER X86-64-BUILD AARCH64-BUILD SYSROOT
#   BUILDS   of the program, by the same compiler and flags; SYSROOT: Debian's arm64 packages (third_party/setup.sh)
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
source="$(cd "$here/../.." && pwd)"
[ $# -eq 4 ] || { sed -n 3,4p "$0" >&2; exit 2; }
build="$1" native="$2" foreign="$3" sysroot="$4"
rm -rf "$build" && mkdir -p "$build"

emulated() { qemu-aarch64 -L "$sysroot" "$@"; }

echo "== what the library computes"
flags=(-std=c++20 -O1 -DNDEBUG -I "$source/include" "$source/test/consumer/results.cpp" -pthread)
g++ "${flags[@]}" -isystem /usr/include/eigen3 -o "$build/results_native"
# As third_party/aarch64.cmake's builds of our own are compiled.
aarch64-linux-gnu-g++-12 --sysroot="$sysroot" "${flags[@]}" -isystem "$sysroot/usr/include/eigen3" -ffp-contract=off \
  -U__ARM_FEATURE_FMA -o "$build/results_emulated"
"$build/results_native" >"$build/results_native.txt"
emulated "$build/results_emulated" >"$build/results_emulated.txt"
[ "$(wc -l <"$build/results_native.txt")" -gt 200 ]
diff "$build/results_native.txt" "$build/results_emulated.txt"
wc -l "$build/results_native.txt"

file "$foreign/examples/chainslam" | grep 'ARM aarch64'
emulated "$foreign/examples/chainslam" --version | grep 'AArch64'

# same_maps DATA NAME "FILE..." ARGUMENT...: maps DATA by both programs; these files must be the same, byte for byte.
same_maps() {
  local data="$1" name="$2" files="$3" file
  shift 3
  "$native/examples/chainslam" map "$data" --out "$build/$name" "$@"
  emulated "$foreign/examples/chainslam" map "$data" --out "$build/${name}_emulated" "$@"
  for file in $files; do cmp "$build/$name/$file" "$build/${name}_emulated/$file"; done
}
results="odometry.tum trajectory.tum keyframes.csv closures.csv frames.csv graph.g2o map.ply"

echo "== the map of a small town"
"$native/examples/chainslam" simulate town-small --out "$build/small"
same_maps "$build/small" map "$results map.cslam" --set dataset.gnss=none
emulated "$foreign/examples/chainslam" check "$build/map/map.cslam"

# The fixes' last bit (1e-9 m) is GeographicLib's, which Debian compiles for arm64 with fused products and sums. Where it
# puts a point of a submap into another voxel, alignments differ by some 0.1 mm, and one more or less may be accepted.
echo "== the map of the embedded town, with fixes and closures: the same odometry, and poses within 2 mm"
"$native/examples/chainslam" simulate town --out "$build/town"
same_maps "$build/town" map_of_town "odometry.tum frames.csv"
[ "$(wc -l <"$build/map_of_town/closures.csv")" -gt 10 ]  # it has closed loops
paste -d ' ' "$build/map_of_town/trajectory.tum" "$build/map_of_town_emulated/trajectory.tum" |
  awk '{ for (i = 2; i <= 4; ++i) { d = $i - $(i + 8); if (d < 0) d = -d; if (d > most) most = d } }
       END { print NR " poses, at most " most " m apart"; exit !(NR > 100 && most < 2e-3) }'
