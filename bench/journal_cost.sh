#!/usr/bin/env bash
# What the two journals of a run cost (the inputs before the back end gets them, the map after each of its steps): their
# share of the program's instructions, by callgrind, and of its time, by the program's own clock.
set -euo pipefail

usage() {
  cat <<TEXT
usage: bench/journal_cost.sh PROGRAM DATA [SCANS]
  PROGRAM   the built chainslam
  DATA      a data set, such as chainslam simulate town --out writes
  SCANS     so many of it under callgrind, which takes fifty times as long (default: 300)
needs valgrind; runs on one thread
TEXT
}
[ $# -ge 2 ] || { usage >&2; exit 2; }
program="$1" data="$2" scans="${3:-300}"
command -v valgrind >/dev/null || { echo "bench/journal_cost.sh: valgrind is missing (apt-get install valgrind)" >&2; exit 2; }
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

valgrind --tool=callgrind --callgrind-out-file="$work/profile" \
  "$program" map "$data" --out "$work/profiled" --max-scans "$scans" --threads 1 >"$work/log" 2>&1
callgrind_annotate --inclusive=yes --threshold=100 "$work/profile" | awk '
  function count() { gsub(",", "", $1); return $1 }
  /PROGRAM TOTALS/ { all = count() }
  /_Function_handler/ { next }
  /mapper::run\(chainslam::mapper::MapArguments const&\)::\{lambda\(std::span/ { inputs += count() }
  /MapJournal<.*>::(update|finish)\(/ { map += count() }
  END {
    if (inputs == 0 || map == 0) { print "the journals were not found in the profile"; exit 1 }
    printf "instructions  %.2f %% journal of inputs, %.2f %% journal of the map, of %.1f billion\n",
           100 * inputs / all, 100 * map / all, all / 1e9
  }'

for i in 1 2 3 4 5; do
  "$program" map "$data" --out "$work/run$i" --threads 1 >"$work/log" 2>&1
  awk -F'[:,]' '
    /"journal": *\{/ { inside = 1 }
    inside && /"total_s"/ { waited = $2; inside = 0 }
    /"wall_seconds"/ { wall = $2 }
    END { printf "time          %.2f %% of %.2f s waiting for the journal of inputs\n", 100 * waited / wall, wall }' \
    "$work/run$i/summary.json"
done
