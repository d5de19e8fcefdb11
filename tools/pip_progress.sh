#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Turn the output of `pip install` into a few lines of progress: pip ... | pip_progress.sh PACKAGES
set -eu
all=$1 found=0
say() {
  if [ -t 1 ]; then printf '\r%s\033[K' "$1"; else echo "$1"; fi
}
while IFS= read -r line; do
  case $line in
    Collecting\ * | Processing\ *)
      found=$((found + 1))
      if [ -t 1 ] || [ $((found % 40)) -eq 0 ]; then say "fetched $found of $all packages"; fi ;;
    Installing\ collected*) say "unpacking $all packages" ;;
    Successfully\ installed*) say "installed $all packages"; if [ -t 1 ]; then echo; fi ;;
  esac
done
