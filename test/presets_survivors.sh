#!/usr/bin/env bash
# presets_survivors.sh TEST_PROGRAM PROGRAM [PRESET...]: changes every value of the presets in turn, and prints those that
# no test misses ("survivor") and those that the table's test alone notices ("table only").
#
# A change is made by an override of the setting, which is what a preset's value is too. Values that the front end alone
# sees have it run again; the others map what it recorded.
set -euo pipefail

tests=$1 program=$2
shift 2
here=$(cd "$(dirname "$0")" && pwd)
keys=$(sed -n '/R"(/,/^)"/p' "$here/program/presets_test.cpp" | awk 'NF > 1 && $1 ~ /\./ { print $1 }')

# Another value of the same kind, from the program's own list: half as much again, one more, the other choice.
changed() {
  local value=$1 key=$2
  case $value in
    true) echo false ;;
    false) echo true ;;
    '"fast_lio2"') echo lidar ;;
    '"point_to_point"') echo point_to_plane ;;
    '"submaps"') echo scan ;;
    '"scan"') echo submaps ;;
    *.* | *e*)
      awk -v v="$value" -v key="$key" 'BEGIN {
        if (v == 0) print 0.5; else if (key == "merge.confidence") print 0.5;
        else if (key == "merge.edge_length_ratio") print 0.45; else if (v >= 1e9) print 0.1;
        else if (key == "odometry.max_range") print 15; else printf "%.17g\n", 1.5 * v }' ;;
    *) awk -v v="$value" 'BEGIN { print v == 0 ? 3 : (v < 3 ? v + 2 : int(v / 2)) }' ;;
  esac
}

value_of() {  # PRESET KEY
  "$program" config --set preset="$1" --print |
    awk -v key="$2" '/^\[/ { table = substr($0, 2, length($0) - 2) "." } !/^#/ && table $1 == key && $2 == "=" { print $3 }'
}

fails() { ! CHAINSLAM_PRESET_CHANGE=$1 "$tests" -ts="program/presets" -tc="$2" >/dev/null 2>&1; }

survivors=0
for preset in "${@:-paper released}"; do
  for preset in $preset; do
    for key in $keys; do
      change="$preset $key=$(changed "$(value_of "$preset" "$key")" "$key")"
      if ! fails "$change" "*have the values*"; then
        echo "survivor: $change"
        survivors=$((survivors + 1))
      elif ! fails "$change" "*three drives*"; then
        echo "table only: $change"
      fi
    done
  done
done
echo "$survivors survivors"
exit $((survivors > 0))
