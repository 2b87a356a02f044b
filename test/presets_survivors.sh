#!/usr/bin/env bash
# Changes every value of the presets in turn, by an override of the setting, and prints those that no test misses
# ("survivor"); with --drives also those that only the table's test misses ("table only").
set -euo pipefail

usage="usage: test/presets_survivors.sh [--drives] [--preset PRESET]... TEST_PROGRAM PROGRAM"
drives=false presets=()
while [ $# -gt 2 ]; do
  case $1 in
    --drives) drives=true ;;
    --preset) presets+=("$2"); shift ;;
    *) echo "$usage" >&2; exit 2 ;;
  esac
  shift
done
[ $# -eq 2 ] || { echo "$usage" >&2; exit 2; }
tests=$1 program=$2
[ ${#presets[@]} -gt 0 ] || presets=(paper released)
here=$(cd "$(dirname "$0")" && pwd)
keys=$(sed -n '/R"(/,/^)"/p' "$here/program/presets_test.cpp" | awk 'NF > 1 && $1 ~ /\./ { print $1 }')

# recorded drives that changes of the back end share
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
export CHAINSLAM_PRESET_SETS="$scratch"

# changed KEY VALUE: another value that the key takes.
changed() {
  case $2 in
    true) echo false ;;
    false) echo true ;;
    '"fast_lio2"') echo lidar ;;
    '"point_to_point"') echo point_to_plane ;;
    '"submaps"') echo scan ;;
    '"scan"') echo submaps ;;
    '"lidar"') echo imu ;;
    '"features"') echo verified ;;
    *.* | *e*)
      awk -v key="$1" -v v="$2" 'BEGIN {
        if (key ~ /confidence|edge_length_ratio/) print v / 2
        else if (key == "odometry.max_range") print 15
        else if (v == 0) print 0.5
        else if (v >= 1e9) print 0.1
        else printf "%.17g\n", 1.5 * v }' ;;
    *) awk -v v="$2" 'BEGIN { print v < 4 ? v + 2 : int(v / 2) }' ;;
  esac
}

# fails CHANGE CASES: whether the tests of these names fail with the change.
fails() { ! CHAINSLAM_PRESET_CHANGE=$1 "$tests" -ts="program/presets" -tc="$2" >/dev/null 2>&1; }

survivors=0
for preset in "${presets[@]}"; do
  values=$("$program" config --set preset="$preset" --print |
    awk '/^\[/ { table = substr($0, 2, length($0) - 2) "." } !/^#/ && $2 == "=" { print table $1, $3 }')
  for key in $keys; do
    value=$(awk -v key="$key" '$1 == key { print $2 }' <<<"$values")
    change="$preset $key=$(changed "$key" "$value")"
    "$program" config --set preset="$preset" --set "${change#* }" ||
      { echo "presets_survivors.sh: no value for a setting: $change" >&2; exit 2; }
    if ! fails "$change" "*have the values*"; then
      echo "survivor: $change"
      survivors=$((survivors + 1))
    elif $drives && ! fails "$change" "*map three drives*"; then
      echo "table only: $change"
    fi
  done
done
echo "$survivors survivors"
[ "$survivors" -eq 0 ]
