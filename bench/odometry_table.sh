#!/usr/bin/env bash
# Installs what is missing, builds the program that runs the odometries on real and semi-real drives, and writes their table.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

usage() {
  cat <<TEXT
usage: bench/odometry_table.sh [--out FILE.md] [--only DRIVE] [--starts N] [--seed S] [DATASET...]
  --out FILE.md   where the table goes (default: build/odometry_table.md)
  --only DRIVE    only drives whose name contains this: kitti00_first101, kitti00_keyframes_imu, nuscenes_scene,
                  muehlburger_tor; simulated scans with real IMU data: semi_real_00, _05, _06, _07, _09
  --starts N      as well: N starts at random times of the semi-real drives, 20 s each (default: 0)
  --seed S        of these times (default: 1)
  DATASET         data sets with their truth in folders, such as chainslam simulate writes
environment: CHAINSLAM_BUILD_DIR (default: build/), CHAINSLAM_DATA (a folder of real data), CHAINSLAM_JOBS
TEXT
}

. "$root/third_party/setup.sh"
out="$build/odometry_table.md" only="" starts=0 seed=1 datasets=()
while [ $# -gt 0 ]; do
  case "$1" in
    --out | --only | --starts | --seed) [ $# -ge 2 ] || { usage >&2; exit 2; }
      printf -v "${1#--}" %s "$2"
      shift ;;
    -h | --help) usage; exit 0 ;;
    -*) usage >&2; echo "bench/odometry_table.sh: unknown option $1" >&2; exit 2 ;;
    *) datasets+=("$1") ;;
  esac
  shift
done

# shellcheck disable=SC2086
install_packages $packages_build $packages_program $packages_bench
unpack_data
configure_and_build bench "the drives, -O3" bench_drives -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER=g++ \
  -DCHAINSLAM_BUILD_TESTS=OFF
"$build/bench/bench/bench_drives" --out "$out" --only "$only" --starts "$starts" --seed "$seed" \
  ${datasets[@]+"${datasets[@]}"} || fail "bench_drives stopped"

version="$(git -C "$root" describe --always --dirty 2>/dev/null || echo "unknown version")"
processor="$(sed -n 's/^model name[[:space:]]*: //p' /proc/cpuinfo | head -n 1)"
printf '\nWritten by `bench/odometry_table.sh`: %s, g++ %s, %s.\n' "$version" "$(g++ -dumpfullversion)" "${processor:-unknown processor}" >>"$out"
say "passed" "the table is in $out"
