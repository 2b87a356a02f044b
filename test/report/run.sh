#!/usr/bin/env bash
# Opens reports of the mapper in Chromium, without a display, and checks what they show, also on paper, on narrow screens and
# without WebGL.
# usage: test/report/run.sh PROGRAM [FOLDER [TEST...]]
#   PROGRAM  build/.../examples/chainslam
#   FOLDER   where drives and maps are made, and kept; default: a temporary one
#   TEST     for example report_test.View
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
root="$(cd "$here/../.." && pwd)"
. "$root/third_party/setup.sh"

case "${1:-}" in
  "" | -*) sed -n 4,7p "$0" >&2; exit 2 ;;
esac
[ -x "$1" ] || fail "$1 is no program; build one with examples/run.sh help"
program="$(cd "$(dirname "$1")" && pwd)/$(basename "$1")"
# shellcheck disable=SC2086
install_packages $packages_report
export PYTHONDONTWRITEBYTECODE=1
if [ $# -gt 1 ]; then
  mkdir -p "$2" && folder="$(cd "$2" && pwd)"
else
  folder="$(mktemp -d)"
  trap 'rm -rf "$folder"' EXIT
fi
shift $(($# > 1 ? 2 : 1))

# map NAME DRIVE... -- ARGUMENT...: makes FOLDER/NAME of made-up drives.
map() {
  local name="$1" drives=()
  shift
  while [ "$1" != -- ]; do drives+=("$folder/drives/$1"); shift; done
  shift
  rm -rf "${folder:?}/$name"
  "$program" map "${drives[@]}" --out "$folder/$name" "$@" >"$folder/$name.log" 2>&1 ||
    { tail -n 20 "$folder/$name.log" >&2; fail "the mapper stopped"; }
}
rm -rf "$folder/drives"
"$(debian_python)" "$here/made_up_drives.py" "$folder/drives"
map small first second -- --set output.map_voxel=0.4 \
  --truth "$folder/drives/first/truth.tum" --truth "$folder/drives/second/truth.tum"
map apart first second -- --set output.map_voxel=0.4 --set merge.enabled=false
map large dense -- --set output.map_voxel=0.1 --set keyframes.voxel_size=0.1 --set closures.radius=0.1
cd "$here"
CHAINSLAM_REPORTS="$folder" "$(debian_python)" -m unittest "${@:-report_test}"
