#!/usr/bin/env bash
# Runs the example from end to end, and checks the comparison that it prints against the two maps' own figures.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
. "$root/third_party/setup.sh"
log="$(mktemp)"
trap 'rm -f "$log"' EXIT
"$root/examples/run.sh" | tee "$log"

# check NAME LABEL FIXES: FIXES is an extended regular expression of how many the map has.
check() {
  local summary="$build/demo/$1/summary.json" expected
  expected="$("$(debian_python)" - "$summary" <<'PYTHON'
import json, sys
summary = json.load(open(sys.argv[1]))
assert {session["frame"] for session in summary["sessions"]} == {0}, "sessions in several frames"
all, between = (summary["errors"][of][kind]["translation"]["rmse"] for of, kind in (("optimized", "ape"), ("inter_session", "rpe")))
print(f"3 sessions in 1 frame, error {all:.3f} m, {between:.3f} m between sessions")
PYTHON
)"
  grep -E "^$2 +" "$log" | grep -qF "$expected" || fail "the comparison does not print '$expected' for '$2'"
  grep -qF "$build/demo/$1/report.html" "$log" && [ -s "$build/demo/$1/report.html" ] || fail "no report of $1"
  "$build/release/examples/chainslam" inspect "$build/demo/$1/map.cslam" | grep -Eq "^ *gnss fixes +$3\$" ||
    fail "$1 has not $3 fixes"
}
check map "with GNSS" '[1-9][0-9]*'
check map_without_gnss without 0
[ "$(grep -cE '^ +sessions [0-9] and [0-9]: [1-9]?[0-9]+ places?, ' "$log")" -eq 6 ] || fail "not three joins for each map"
