#!/usr/bin/env bash
# Checks that every public header compiles alone, included by nothing but itself; with --all those in detail/ as well.
# usage: test/headers.sh INCLUDE-FOLDER [--all]
# Asks $CXX, else clang++-14. Eigen's core, and its geometry, are precompiled for the headers that include them, which
# takes less than half of the time; those that do not are compiled without, so that none leans on it. Each is precompiled,
# which leaves what its functions would instantiate to those who include it.
set -euo pipefail
[ $# -gt 0 ] || { sed -n 3p "$0" >&2; exit 2; }
include="$(cd "$1" && pwd)"
hidden=/detail/
[ "${2-}" = --all ] && hidden=/none/
compiler="${CXX:-clang++-14}"
command -v "$compiler" >/dev/null || { echo "headers: no compiler $compiler" >&2; exit 2; }

flags=(-std=c++20 -I "$include")
for flag in $(pkg-config --cflags-only-I eigen3); do flags+=(-isystem "${flag#-I}"); done
for folder in {/usr/local,/usr}/include/suitesparse; do [ -d "$folder" ] && flags+=(-isystem "$folder"); done

scratch="$(mktemp -d)"
trap 'rm -r "$scratch"' EXIT
cd "$include"
find chainslam -name '*.hpp' | LC_ALL=C sort >"$scratch/all"
xargs grep -H '^#include ["<]\(chainslam\|Eigen\)/' <"$scratch/all" >"$scratch/lines"

# precompile PART PATTERN: precompiles Eigen/PART for the headers that include what fits PATTERN, themselves or through
# others of ours, and lists them.
precompile() {
  echo "#include <Eigen/$1>" >"$scratch/$1.hpp"
  "$compiler" "${flags[@]}" -x c++-header "$scratch/$1.hpp" -o "$scratch/$1.pch" &
  awk -F'[:"<>]' -v pattern="$2" '
    { from[NR] = $1; to[NR] = $3; if ($3 ~ pattern) with[$1] = 1 }
    END { do { grown = 0; for (i in from) if (to[i] in with && !(from[i] in with)) with[from[i]] = grown = 1 } while (grown)
          for (header in with) print header }' "$scratch/lines" >"$scratch/with_$1"
}
precompile Core '^Eigen/'
precompile Geometry '^Eigen/Geometry$'
wait
[ -s "$scratch/with_Geometry" ] || { echo "headers: none includes Eigen's geometry, which cannot be" >&2; exit 1; }

# verdict HEADER: nothing if it compiles alone, else what the compiler says.
verdict() {
  local part with=()
  for part in Core Geometry; do
    grep -qxF "$1" "$scratch/with_$part" && with=(-include-pch "$scratch/$part.pch")
  done
  echo "#include \"$1\"" |
    "$compiler" "${flags[@]}" ${with[@]+"${with[@]}"} -x c++-header - -o /dev/null 2>&1 | head -n 20
}

# The check itself must be able to fail.
mkdir "$scratch/chainslam"
echo 'inline std::vector<int> without_include;' >"$scratch/chainslam/bad.hpp"
flags+=(-I "$scratch")
[ -n "$(verdict chainslam/bad.hpp)" ] || { echo "headers: the check sees no missing include" >&2; exit 1; }

number=0
while read -r header; do
  case "$header" in *"$hidden"* | chainslam/chainslam.hpp) continue ;; esac  # consumers include all, and nothing else
  while [ "$(jobs -rp | wc -l)" -ge "${CHAINSLAM_JOBS:-$(nproc)}" ]; do wait -n || true; done
  number=$((number + 1))
  verdict "$header" >"$scratch/$number.verdict" &
done <"$scratch/all"
wait
echo "headers: $number, $(wc -l <"$scratch/with_Core") of all with Eigen"
cat "$scratch"/*.verdict
[ -z "$(cat "$scratch"/*.verdict)" ]
