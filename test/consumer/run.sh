#!/usr/bin/env bash
# Builds a user's project against the library as users may take it: installed, or as a folder of theirs; with --all by
# FetchContent and by pkg-config and a bare compiler as well. All of the library is included by the installed one alone, with
# --all by each.
# usage: test/consumer/run.sh BUILD-FOLDER [--all] [--library FOLDER]
#   --library FOLDER  a build of the library with CHAINSLAM_COMPILED=ON, which is installed; without it header-only
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
source="$(cd "$here/../.." && pwd)"
build="$1" ways="find_package add_subdirectory" all=no library=""
shift
while [ $# -gt 0 ]; do
  case "$1" in
    --all) all=yes ways="$ways fetch_content" ;;
    --library) library="$(cd "$2" && pwd)"; shift ;;
    *) sed -n 5,6p "$0" >&2; exit 2 ;;
  esac
  shift
done
rm -rf "$build" && mkdir -p "$build"

if [ -z "$library" ]; then
  cmake -S "$source" -B "$build/library" -G Ninja -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BUILD_BENCH=OFF \
    -DCHAINSLAM_BUILD_EXAMPLES=OFF
  cmake --build "$build/library"
fi
cmake --install "${library:-$build/library}" --prefix "$build/prefix"

for how in $ways; do
  echo "== $how"
  whole=ON
  [ "$all" = no ] && [ "$how" != find_package ] && whole=OFF
  cmake -S "$here" -B "$build/$how" -G Ninja -DHOW="$how" -DCHAINSLAM_SOURCE="$source" -DCMAKE_PREFIX_PATH="$build/prefix" \
    -DWHOLE="$whole" ${library:+-DMORE_COMPONENTS=compiled}
  cmake --build "$build/$how"
  "$build/$how/consumer"
done
"$build/find_package/archive"
if [ -n "$library" ]; then
  echo "== header-only and compiled results are bit-identical"
  for how in chainslam compiled; do "$build/find_package/results_$how" >"$build/results_$how.txt"; done
  [ "$(wc -l <"$build/results_compiled.txt")" -gt 50 ]
  diff "$build/results_chainslam.txt" "$build/results_compiled.txt"
fi

if [ "$all" = yes ]; then
  echo "== pkg-config and a bare compiler"
  flags="$(PKG_CONFIG_PATH="$build/prefix/share/pkgconfig" pkg-config --cflags chainslam)"
  # shellcheck disable=SC2086
  g++ -std=c++20 "$here/main.cpp" "$here/other.cpp" $flags -pthread -o "$build/bare"
  "$build/bare"
fi

echo "== the README's first program compiles as it stands"
awk '/^```cpp/ { inside = 1; next } /^```/ { inside = 0 } inside' "$source/README.md" >"$build/quick_start.cpp"
[ "$(wc -l <"$build/quick_start.cpp")" -gt 8 ]
# shellcheck disable=SC2046
"${CXX:-g++}" -std=c++20 -fsyntax-only -Wall -Wextra -Werror -isystem "$build/prefix/include" \
  $(pkg-config --cflags-only-I eigen3 | sed 's/-I/-isystem /g') "$build/quick_start.cpp"

echo "== an unknown component is refused, and the known ones are named"
mkdir -p "$build/unknown_source"
printf '%s\n' 'cmake_minimum_required(VERSION 3.25)' 'project(unknown LANGUAGES CXX)' \
  'find_package(chainslam REQUIRED COMPONENTS teapot)' >"$build/unknown_source/CMakeLists.txt"
if cmake -S "$build/unknown_source" -B "$build/unknown" -DCMAKE_PREFIX_PATH="$build/prefix" >"$build/unknown.log" 2>&1; then
  echo "component teapot was found" >&2
  exit 1
fi
grep -q "has no component 'teapot'" "$build/unknown.log"
echo "consumers: all built and ran"
