#!/usr/bin/env bash
# Checks that every public header compiles alone, included by nothing but itself; with --all those in detail/ as well.
# usage: test/headers.sh INCLUDE-FOLDER [--all]
# Asks $CXX, else clang++-14. Eigen's core is precompiled for the headers that include it, which halves the time; those
# that do not are compiled without, so that none leans on it. Each is precompiled, which leaves what its functions would
# instantiate to those who include it.
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
echo '#include <Eigen/Core>' >"$scratch/eigen.hpp"
"$compiler" "${flags[@]}" -x c++-header "$scratch/eigen.hpp" -o "$scratch/eigen.pch"

# Headers that include Eigen, themselves or through others of ours.
cd "$include"
find chainslam -name '*.hpp' | LC_ALL=C sort >"$scratch/all"
xargs grep -H '^#include ["<]\(chainslam\|Eigen\)/' <"$scratch/all" | awk -F'[:"<>]' '
  { from[NR] = $1; to[NR] = $3; if ($3 ~ /^Eigen\//) with[$1] = 1 }
  END { do { grown = 0; for (i in from) if (to[i] in with && !(from[i] in with)) with[from[i]] = grown = 1 } while (grown)
        for (header in with) print header }' >"$scratch/with_eigen"
[ -s "$scratch/with_eigen" ] || { echo "headers: none includes Eigen, which cannot be" >&2; exit 1; }

# verdict HEADER: nothing if it compiles alone, else what the compiler says.
verdict() {
  local with=()
  grep -qxF "$1" "$scratch/with_eigen" && with=(-include-pch "$scratch/eigen.pch")
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
  case "$header" in *"$hidden"*) continue ;; esac
  while [ "$(jobs -rp | wc -l)" -ge "${CHAINSLAM_JOBS:-$(nproc)}" ]; do wait -n || true; done
  number=$((number + 1))
  verdict "$header" >"$scratch/$number.verdict" &
done <"$scratch/all"
wait
echo "headers: $number, $(wc -l <"$scratch/with_eigen") of all with Eigen"
cat "$scratch"/*.verdict
[ -z "$(cat "$scratch"/*.verdict)" ]
