#!/usr/bin/env bash
# Builds a user's project against the library as users may take it: installed from the Debian package, or as a folder of
# theirs; with --all by FetchContent and by pkg-config and a bare compiler as well. All of the library is included by the
# installed one alone, with --all by each.
# usage: test/consumer/run.sh BUILD-FOLDER [--all] [--library FOLDER]
#   --library FOLDER  a build of the library with CHAINSLAM_COMPILED=ON and of the program, which are installed; without it
#                     headers only
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
source="$(cd "$here/../.." && pwd)"
build="$1" ways="find_package add_subdirectory" all=no library=""
shift
while [ $# -gt 0 ]; do
  case "$1" in
    --all) all=yes ways="$ways fetch_content" ;;
    --library) library="$(cd "$2" && pwd)"; shift ;;
    *) sed -n 5,7p "$0" >&2; exit 2 ;;
  esac
  shift
done
rm -rf "$build" && mkdir -p "$build"

if [ -z "$library" ]; then
  cmake -S "$source" -B "$build/library" -G Ninja -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BUILD_BENCH=OFF \
    -DCHAINSLAM_BUILD_EXAMPLES=OFF
  cmake --build "$build/library"
fi

cmake --install "${library:-$build/library}" --prefix "$build/prefix" >"$build/install.log"
prefix="$build/prefix"

# install_package BUILD: makes the Debian package and installs it in a root folder with a list of packages of its own, as
# dpkg does for root only.
install_package() {
  cpack --config "$1/CPackConfig.cmake" -B "$build/package"
  package="$(realpath "$build"/package/*.deb)"
  dpkg-deb --info "$package"
  mkdir -p "$build/root/var/lib/dpkg/info" "$build/root/var/lib/dpkg/updates"
  if [ "$(id -u)" -eq 0 ]; then
    touch "$build/root/var/lib/dpkg/status"
    # What it depends on is in the system's own list.
    dpkg --root="$build/root" --log="$build/dpkg.log" --force-depends --install "$package"
  else
    dpkg-deb --extract "$package" "$build/root"
  fi
  apt-get --simulate install "$package"  # Debian has what it depends on
  prefix="$build/root/usr"
}

# broken_links FOLDER: links of pages that lead to no file.
broken_links() {
  local page link
  find "$1" -name '*.md' | while read -r page; do
    # Lambdas in code look like links.
    awk '/^```/ { code = !code } !code' "$page" | { grep -oE '\]\([^)#]+' || true; } | sed 's/^](//' | while read -r link; do
      case "$link" in http*) ;; *) [ -e "$(dirname "$page")/$link" ] || echo "$page: $link" ;; esac
    done
  done
}

package=""
if command -v dpkg-deb >/dev/null; then
  echo "== the Debian package holds what cmake --install installs"
  install_package "${library:-$build/library}"
  diff <(cd "$build/prefix" && find . -type f | sort) <(cd "$prefix" && find . -type f | sort)
else
  echo "== not a Debian system: no package is made"
fi

echo "== links of the installed pages lead to installed files"
broken_links "$prefix/share/doc/chainslam" | tee "$build/broken_links.txt"
[ ! -s "$build/broken_links.txt" ]
[ "$(find "$prefix/share/doc/chainslam/include" -name README.md | wc -l)" -gt 10 ]

for how in $ways; do
  echo "== $how"
  whole=ON
  [ "$all" = no ] && [ "$how" != find_package ] && whole=OFF
  cmake -S "$here" -B "$build/$how" -G Ninja -DHOW="$how" -DCHAINSLAM_SOURCE="$source" -DCMAKE_PREFIX_PATH="$prefix" \
    -DWHOLE="$whole" ${library:+-DMORE_COMPONENTS=compiled}
  cmake --build "$build/$how"
  "$build/$how/consumer"
done
"$build/find_package/archive"
if [ -n "$library" ]; then
  echo "== the installed program checks a map that a user's program has written"
  "$prefix/bin/chainslam" --version
  "$prefix/bin/chainslam" check "$build/find_package/archive.cslam"
  if [ -n "$package" ]; then
    "$prefix/bin/chainslam" --version | grep -F "chainslam $(dpkg-deb --field "$package" Version)"
    dpkg-deb --field "$package" Depends | grep 'libc6.*libsqlite3-0'
  fi
  echo "== header-only and compiled results are bit-identical"
  for how in chainslam compiled; do "$build/find_package/results_$how" >"$build/results_$how.txt"; done
  [ "$(wc -l <"$build/results_compiled.txt")" -gt 50 ]
  diff "$build/results_chainslam.txt" "$build/results_compiled.txt"
fi

if [ "$all" = yes ]; then
  echo "== pkg-config and a bare compiler"
  flags="$(PKG_CONFIG_PATH="$prefix/share/pkgconfig" pkg-config --cflags chainslam)"
  # shellcheck disable=SC2086
  g++ -std=c++20 "$here/main.cpp" "$here/other.cpp" $flags -pthread -o "$build/bare"
  "$build/bare"
fi

echo "== the README's first program compiles as it stands"
awk '/^```cpp/ { inside = 1; next } /^```/ { inside = 0 } inside' "$source/README.md" >"$build/quick_start.cpp"
[ "$(wc -l <"$build/quick_start.cpp")" -gt 8 ]
# shellcheck disable=SC2046
"${CXX:-g++}" -std=c++20 -fsyntax-only -Wall -Wextra -Werror -isystem "$prefix/include" \
  $(pkg-config --cflags-only-I eigen3 | sed 's/-I/-isystem /g') "$build/quick_start.cpp"

echo "== an unknown component is refused, and the known ones are named"
mkdir -p "$build/unknown_source"
printf '%s\n' 'cmake_minimum_required(VERSION 3.25)' 'project(unknown LANGUAGES CXX)' \
  'find_package(chainslam REQUIRED COMPONENTS teapot)' >"$build/unknown_source/CMakeLists.txt"
if cmake -S "$build/unknown_source" -B "$build/unknown" -DCMAKE_PREFIX_PATH="$prefix" >"$build/unknown.log" 2>&1; then
  echo "component teapot was found" >&2
  exit 1
fi
grep -q "has no component 'teapot'" "$build/unknown.log"
echo "consumers: all built and ran"
