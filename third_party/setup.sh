# Sourced by examples/run.sh, test/run.sh, bench/run.sh and bench/experiments/run.sh: packages, build folder, real data.
#
# In:  root  the checkout. Environment: CHAINSLAM_BUILD_DIR, CHAINSLAM_DATA, CHAINSLAM_JOBS (default: all cores).
# Out: build, jobs; functions say, fail, install_packages, configure_and_build, unpack_data.

build="${CHAINSLAM_BUILD_DIR:-$root/build}"
jobs="${CHAINSLAM_JOBS:-$(nproc)}"

say() { printf '%-12s %s\n' "$1" "$2"; }
fail() {
  say "failed" "$1" >&2
  exit "${2:-1}"
}

packages_build="g++ cmake ninja-build pkg-config libeigen3-dev"
packages_program="libtomlplusplus-dev libcli11-dev nlohmann-json3-dev libgeographiclib-dev libpng-dev libjs-three libzstd-dev libxxhash-dev liblz4-dev libbz2-dev libsqlite3-dev"
packages_test="dpkg-dev file doctest-dev libnanoflann-dev libsuitesparse-dev xz-utils unzip time"
packages_sanitizers="clang-14 libclang-rt-14-dev"
packages_docs="doxygen"
packages_mpi="openmpi-bin libopenmpi-dev openssh-client procps"  # mpirun asks for ssh; the test for pgrep
packages_report="chromium chromium-driver python3-selenium python3-numpy python3-pil"
packages_bench="libbenchmark-dev libboost-dev libnanoflann-dev libsuitesparse-dev xz-utils unzip"
packages_peers="libpcl-dev libopen3d-dev libceres-dev libfmt-dev liblz4-dev"
packages_experiments="python3 python3-numpy python3-scipy python3-matplotlib"
packages_aarch64="g++-12-aarch64-linux-gnu qemu-user"
packages_arm64="libeigen3-dev libnanoflann-dev libsuitesparse-dev doctest-dev ${packages_program/libjs-three /}"  # of arm64
packages_kiss_matcher="libflann-dev liblz4-dev libtbb-dev"  # which is built from sources

# The Python that Debian's packages are for, whatever comes first in PATH.
debian_python() { if [ -x /usr/bin/python3 ]; then echo /usr/bin/python3; else echo python3; fi; }

# Installs the Debian packages that are missing; says which.
install_packages() {
  local missing=() name
  command -v dpkg-query >/dev/null || { say "packages" "not a Debian system: taking what is installed"; return 0; }
  for name in "$@"; do
    dpkg-query -W -f='${Status}' "$name" 2>/dev/null | grep -q '^install ok installed' || missing+=("$name")
  done
  if [ ${#missing[@]} -eq 0 ]; then say "packages" "$# of $# present"; return 0; fi
  say "packages" "installing ${missing[*]}"
  local as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "root or sudo is needed; run as root: apt-get install ${missing[*]}"
    as_root=(sudo)
  fi
  local log="$build/packages.log"
  mkdir -p "$build" || fail "cannot write to $build; set CHAINSLAM_BUILD_DIR to a folder that can be written"
  { "${as_root[@]}" apt-get update &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${missing[@]}"; } \
    >"$log" 2>&1 || { tail -n 15 "$log" >&2; fail "apt-get could not install them; the whole log is in $log"; }
}

# unpack_foreign_packages FOLDER ARCHITECTURE PACKAGE...: Debian's packages for another architecture and all that they need,
# once, in a folder that compilers and emulators take for the root. With a list of packages of its own: the system's would
# want each of its libraries in the same version for both.
unpack_foreign_packages() {
  local folder="$1" architecture="$2" state="$1.apt" file link
  shift 2
  if [ "$(cat "$folder/unpacked" 2>/dev/null)" = "$*" ]; then say "packages" "$architecture: present in $folder"; return 0; fi
  say "packages" "$architecture: unpacking into $folder"
  rm -rf "$folder" "$state"
  mkdir -p "$folder" "$state/lists/partial" "$state/archives/partial" && : >"$state/status"
  local apt=(apt-get -o "APT::Architecture=$architecture" -o "APT::Architectures=$architecture" -o "Dir::State=$state"
             -o "Dir::State::status=$state/status" -o "Dir::Cache=$state" -o Debug::NoLocking=true)
  { "${apt[@]}" update && "${apt[@]}" install --download-only --yes --no-install-recommends "$@"; } >"$state/log" 2>&1 ||
    { tail -n 15 "$state/log" >&2; fail "apt-get could not download them; the whole log is in $state/log"; }
  for file in "$state"/archives/*.deb; do dpkg-deb --extract "$file" "$folder" || fail "cannot unpack $file"; done
  while IFS= read -r -d '' link; do ln -sfn "$folder$(readlink "$link")" "$link"; done < <(find "$folder" -lname '/*' -print0)
  # Which of several BLAS there is a package's script would link.
  for file in "$folder"/usr/lib/*/blas/libblas.so* "$folder"/usr/lib/*/lapack/liblapack.so*; do
    [ ! -e "$file" ] || ln -sfn "$file" "$(dirname "$(dirname "$file")")/"
  done
  rm -rf "$state"
  echo "$*" >"$folder/unpacked"
}

# show_progress LABEL LOG: until stopped, rewrites a line of the terminal with how far Ninja has come.
show_progress() {
  local steps
  while sleep 1 && kill -0 $$ 2>/dev/null; do  # not longer than the script itself
    steps="$(tail -n 1 "$2" 2>/dev/null | grep -oE '^\[[0-9]+/[0-9]+\]' || true)"
    printf '\r%-12s %s %s' "building" "$1" "$steps"
  done
}

# configure_and_build FOLDER LABEL TARGETS CMAKE-ARGUMENTS...: builds quietly; on an error prints it and stops.
configure_and_build() {
  local folder="$build/$1" label="$2" targets="$3" log progress="" status=0 start=$SECONDS
  shift 3
  mkdir -p "$folder" || fail "cannot write to $folder; set CHAINSLAM_BUILD_DIR to a folder that can be written"
  log="$folder/build.log"
  if [ -t 1 ]; then
    show_progress "$label" "$log" &
    progress=$!
  else
    say "building" "$label; the log is $log"
  fi
  # shellcheck disable=SC2086
  { cmake -S "$root" -B "$folder" -G Ninja "$@" && cmake --build "$folder" -j "$jobs" --target $targets; } \
    >"$log" 2>&1 || status=$?
  if [ -n "$progress" ]; then
    kill "$progress" && wait "$progress" 2>/dev/null || true
    printf '\r\033[K'
  fi
  if [ "$status" -ne 0 ]; then
    { grep -E -A 12 'error|FAILED|CMake Error' "$log" || tail -n 20 "$log"; } | sed -n 1,60p >&2
    fail "the build stopped; the whole log is in $log"
  fi
  say "build" "$label: $((SECONDS - start)) s"
}

# Finds the folder of real data and unpacks its archives once, below the build folder; the data itself is never written
# to. Exports CHAINSLAM_UNPACKED_DATA: the unpacked folder, or empty when there is no data.
# An archive a/b.tar.xz is unpacked into a/b/, a/c.zip into a/c/, a file a/d.txt.xz to a/d.txt; other files are linked.
unpack_data() {
  local source="${CHAINSLAM_DATA:-}" file target
  export CHAINSLAM_UNPACKED_DATA=""
  if [ -z "$source" ] && [ -d "$root/../shared/data" ]; then source="$root/../shared/data"; fi
  if [ -z "$source" ]; then
    say "data" "none: CHAINSLAM_DATA is unset; what needs real data is skipped"
    return 0
  fi
  [ -d "$source" ] || fail "CHAINSLAM_DATA=$source is not a folder; set it to a folder of data sets, or unset it"
  source="$(cd "$source" && pwd)"
  while IFS= read -r -d '' file; do
    target="$build/data/${file#"$source"/}"
    case "$file" in
      *.tar.xz) target="${target%.tar.xz}" ;;
      *.tar) target="${target%.tar}" ;;
      *.zip) target="${target%.zip}" ;;
      *.xz) target="${target%.xz}" ;;
    esac
    if [ -e "$target" ] && [ -e "$target.stamp" ] && [ ! "$file" -nt "$target.stamp" ]; then continue; fi
    mkdir -p "$(dirname "$target")"
    rm -rf "$target" "$target.part"
    case "$file" in
      *.tar.xz | *.tar) mkdir "$target.part" && tar -xf "$file" -C "$target.part" --no-same-owner ;;
      *.zip) mkdir "$target.part" && unzip -q "$file" -d "$target.part" ;;
      *.xz) xz -dc "$file" >"$target.part" ;;
      *) ln -s "$file" "$target.part" ;;
    esac || fail "cannot unpack $file into $target.part: is the disk full, or the archive damaged?"
    mv "$target.part" "$target" && touch "$target.stamp"
  done < <(find "$source" -type f -print0)
  CHAINSLAM_UNPACKED_DATA="$build/data"
  say "data" "$source (unpacked in $CHAINSLAM_UNPACKED_DATA)"
}
