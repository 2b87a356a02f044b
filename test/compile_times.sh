#!/usr/bin/env bash
# Compiles a small user program for each entry point of the library and prints the cost relative to a file that
# uses Eigen alone.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"

usage() {
  cat <<TEXT
usage: test/compile_times.sh [--check] [--compiled] [--small-gicp DIR] [--nanoflann DIR] [--gtsam DIR] [PROGRAM...]
  --check           fail where a program exceeds its bound over the Eigen file (test/compile_times/bounds.txt) three times
  --compiled        as programs that link chainslam::compiled; the library itself is not built
  --small-gicp DIR, --nanoflann DIR, --gtsam DIR
                    the folder of a peer's headers: its program is compiled, too
  PROGRAM           only these programs of test/compile_times/, for instance: icp smoother
environment: CXX (compilers, default: "g++ clang++-14", those that are installed), CXXFLAGS (default: -O2)
Prints CPU seconds of the user, their ratio to the Eigen file's and peak memory. Read the ratios: a loaded machine is slow.
TEXT
}

check=no mode=header names=() peers=()
while [ $# -gt 0 ]; do
  case "$1" in
    --check) check=yes ;;
    --compiled) mode=compiled ;;
    --small-gicp | --nanoflann | --gtsam)
      [ $# -ge 2 ] && [ -d "$2" ] || { echo "compile_times: $1 needs a folder of headers" >&2; exit 2; }
      peers+=("${1#--}=$(cd "$2" && pwd)"); shift ;;
    -h | --help) usage; exit 0 ;;
    *)
      [ -f "$here/compile_times/$1.cpp" ] || { usage >&2; echo "compile_times: no program $1" >&2; exit 2; }
      names+=("$1") ;;
  esac
  shift
done
if [ ${#names[@]} -eq 0 ]; then
  names=(kd_tree ikd_tree icp pose_graph smoother filter lidar_odometry lidar_inertial_odometry back_end map_file umbrella)
fi

flags=(-std=c++20 -I "$here/../include")
for flag in $(pkg-config --cflags-only-I eigen3); do flags+=(-isystem "${flag#-I}"); done
# shellcheck disable=SC2206
flags+=(${CXXFLAGS:--O2})
own=()
[ "$mode" = compiled ] && own=(-DCHAINSLAM_COMPILED)

type -P time >/dev/null || { echo "compile_times: time is missing; run: apt-get install time" >&2; exit 2; }
scratch="$(mktemp -d)"
trap 'rm -r "$scratch"' EXIT

# cost COMPILER FILE FLAG...: "SECONDS MEGABYTES" of compiling it.
cost() {
  local compiler="$1" file="$2"
  shift 2
  command time -f '%U %M' -o "$scratch/time" "$compiler" "${flags[@]}" "$@" -c "$file" -o "$scratch/object" \
    2>"$scratch/errors" || { head -n 40 "$scratch/errors" >&2; return 1; }
  awk '{ printf "%s %.0f\n", $1, $2 / 1024 }' "$scratch/time"
}

# Of the Eigen file, before and after each program: a machine is not as fast in one minute as in the next.
eigen_seconds() { cost "$1" "$here/compile_times/eigen.cpp" | cut -d' ' -f1; }

missed=0
# row COMPILER NAME FILE BOUND FLAG...: once more, up to three times, where the bound is exceeded.
row() {
  local tries=1
  [ "$check" = yes ] && tries=3
  for ((; tries > 0; --tries)); do
    if measure "$@"; then return; fi
  done
  missed=$((missed + 1))
}

# measure COMPILER NAME FILE BOUND FLAG...: fails where the bound is exceeded.
measure() {
  local compiler="$1" name="$2" file="$3" bound="$4" before figures after
  shift 4
  before="$eigen"
  figures="$(cost "$compiler" "$file" "$@")" || { echo "compile_times: $name does not compile with $compiler" >&2; exit 1; }
  after="$(eigen_seconds "$compiler")"
  eigen="$after"
  read -r seconds megabytes <<<"$figures"
  awk -v compiler="$compiler" -v name="$name" -v s="$seconds" -v m="$megabytes" -v a="$before" -v b="$after" \
    -v bound="$bound" -v check="$check" 'BEGIN {
      ratio = s / ((a + b) / 2)
      over = check == "yes" && bound != "" && ratio > bound
      printf "%-11s %-26s %7.1f s %7.1f x Eigen %6d MB", compiler, name, s, ratio, m
      if (bound != "") printf "   bound %s%s", bound, over ? ": EXCEEDED" : ""
      printf "\n"
      exit over }'
}

for compiler in ${CXX:-g++ clang++-14}; do
  command -v "$compiler" >/dev/null || { echo "compile_times: no compiler $compiler" >&2; continue; }
  read -r eigen megabytes <<<"$(cost "$compiler" "$here/compile_times/eigen.cpp")"
  printf '%-11s %-26s %7.1f s %7.1f x Eigen %6d MB\n' "$compiler" "Eigen alone" "$eigen" 1 "$megabytes"
  for name in "${names[@]}"; do
    bound="$(awk -v mode="$mode" -v name="$name" '$1 == mode && $2 == name { print $3 }' "$here/compile_times/bounds.txt")"
    row "$compiler" "$name" "$here/compile_times/$name.cpp" "$bound" ${own[@]+"${own[@]}"}
  done
  for peer in ${peers[@]+"${peers[@]}"}; do
    for file in "$here/compile_times/peers/${peer%%=*}"_*.cpp "$here/compile_times/peers/$(tr - _ <<<"${peer%%=*}")"_*.cpp; do
      [ -f "$file" ] || continue
      row "$compiler" "$(basename "$file" .cpp)" "$file" "" -I "${peer#*=}"
      break
    done
  done
done
[ "$missed" -eq 0 ] || { echo "compile_times: $missed above their bounds" >&2; exit 1; }
