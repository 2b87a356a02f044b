#!/usr/bin/env bash
# Builds a user's project against the library as users may take it: installed, or as a folder of theirs; with --all by
# FetchContent and by pkg-config and a bare compiler as well.
# usage: test/consumer/run.sh BUILD-FOLDER [--all]
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
source="$(cd "$here/../.." && pwd)"
build="$1"
ways="find_package add_subdirectory"
[ "${2-}" = --all ] && ways="$ways fetch_content"
rm -rf "$build" && mkdir -p "$build"

cmake -S "$source" -B "$build/library" -G Ninja -DCMAKE_INSTALL_PREFIX="$build/prefix" -DCHAINSLAM_BUILD_TESTS=OFF \
  -DCHAINSLAM_BUILD_BENCH=OFF -DCHAINSLAM_BUILD_EXAMPLES=OFF
cmake --build "$build/library"
cmake --install "$build/library"

for how in $ways; do
  echo "== $how"
  cmake -S "$here" -B "$build/$how" -G Ninja -DHOW="$how" -DCHAINSLAM_SOURCE="$source" -DCMAKE_PREFIX_PATH="$build/prefix"
  cmake --build "$build/$how"
  "$build/$how/consumer"
done
"$build/find_package/archive"

if [ "${2-}" = --all ]; then
  echo "== pkg-config and a bare compiler"
  flags="$(PKG_CONFIG_PATH="$build/prefix/share/pkgconfig" pkg-config --cflags chainslam)"
  # shellcheck disable=SC2086
  g++ -std=c++20 "$here/main.cpp" "$here/other.cpp" $flags -pthread -o "$build/bare"
  "$build/bare"
fi

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
