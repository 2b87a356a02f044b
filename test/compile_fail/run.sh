#!/usr/bin/env bash
# Checks that mistakes at the library's seams are refused in words that can be understood.
# usage: test/compile_fail/run.sh INCLUDE-FOLDER...
# Each *.cpp here begins with lines `// expect: WORDS`. It must not compile, and the compiler must say all of them; with
# CHAINSLAM_RIGHT defined, which mends the mistake, it must compile. Asks $CXX, else g++ and clang++-14 where there.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
[ $# -gt 0 ] || { sed -n 3,5p "$0" >&2; exit 2; }

flags=(-std=c++20)
for folder in "$@"; do flags+=(-I "$folder"); done
for flag in $(pkg-config --cflags eigen3 2>/dev/null || echo -I/usr/include/eigen3); do
  flags+=(-isystem "${flag#-I}")
done

compilers=()
for compiler in ${CXX:-g++ clang++-14}; do command -v "$compiler" >/dev/null && compilers+=("$compiler"); done
[ ${#compilers[@]} -gt 0 ] || { echo "compile_fail: no compiler: ${CXX:-g++ clang++-14}" >&2; exit 2; }

# ask COMPILER ARGUMENTS...: clang gets the whole library precompiled, what its functions instantiate included: a case takes
# half a second then. Not so a case with a line `// alone: REASON`.
ask() {
  local compiler="$1" library=()
  shift
  [ -e "$scratch/library.$compiler.pch" ] && ! grep -q '^// alone: ' "${@: -1}" && library=(-include-pch "$scratch/library.$compiler.pch")
  "$compiler" "${flags[@]}" ${library[@]+"${library[@]}"} -fsyntax-only "$@"
}

# verdict COMPILER FILE: prints what is wrong with a case; nothing if it is as it should be.
verdict() {
  local compiler="$1" file="$2" message words
  local expected=()
  while read -r words; do expected+=("$words"); done < <(sed -n '/^\/\/ expect: /!q; s///p' "$file")
  if [ ${#expected[@]} -eq 0 ]; then
    echo "does not begin with // expect: WORDS"
    return
  fi
  if ! message="$(ask "$compiler" -DCHAINSLAM_RIGHT "$file" 2>&1)"; then
    printf 'does not compile when it is right:\n%s\n' "$(head -n 20 <<<"$message")"
    return
  fi
  if message="$(ask "$compiler" "$file" 2>&1)"; then
    echo "compiles, mistake and all"
    return
  fi
  for words in "${expected[@]}"; do
    grep -qF -- "$words" <<<"$message" ||
      printf 'does not say "%s" but:\n%s\n' "$words" "$(head -n 20 <<<"$message")"
  done
}

failed=0
scratch="$(mktemp -d)"
trap 'rm -r "$scratch"' EXIT

# report NAME TEXT: counts a case whose verdict is not empty.
report() {
  if [ -z "$2" ]; then
    echo "passed: $1"
  else
    failed=$((failed + 1))
    echo "FAILED: $1 $2"
  fi
}

for compiler in "${compilers[@]}"; do
  case "$compiler" in
    clang*) echo '#include "chainslam/chainslam.hpp"' |
      "$compiler" "${flags[@]}" -fpch-instantiate-templates -x c++-header - -o "$scratch/library.$compiler.pch" ;;
  esac
done

# The check itself must be able to fail: three cases that are not as they should be.
printf '// expect: anything\nint right;\n' >"$scratch/compiles.cpp"
printf '// expect: these very words\n#ifndef CHAINSLAM_RIGHT\nstatic_assert(false, "others");\n#endif\n' \
  >"$scratch/other_words.cpp"
printf '// expect: others\nstatic_assert(false, "others");\n' >"$scratch/never_right.cpp"
for case in compiles other_words never_right; do
  [ -n "$(verdict "${compilers[0]}" "$scratch/$case.cpp")" ] || report "the check does not see $case" "at all"
done

for compiler in "${compilers[@]}"; do
  for file in "$here"/*.cpp; do
    while [ "$(jobs -rp | wc -l)" -ge "${CHAINSLAM_JOBS:-$(nproc)}" ]; do wait -n || true; done
    verdict "$compiler" "$file" >"$scratch/$compiler $(basename "$file" .cpp).verdict" &
  done
done
wait
for file in "$scratch"/*.verdict; do report "$(basename "$file" .verdict)" "$(<"$file")"; done
[ "$failed" -eq 0 ]
