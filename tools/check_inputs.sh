#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Refuse at once, in one line, what would fail after minutes of work:
# check_inputs.sh CLONE OUT SEED ROBOTS [FILES,...]...
set -eu
clone=$1 out=$2 seed=$3 robots=$4
shift 4
refuse() {
  echo "$*" >&2
  exit 1
}
case $seed in *[!0-9]*) refuse "SEED=$seed: a seed is a whole number, 0 or more" ;; esac
[ ${#seed} -le 18 ] || refuse "SEED=$seed: a seed has 18 digits at most"
case $robots in *[!0-9]* | 0*) refuse "ROBOTS=$robots: robots are a whole number, 1 or more" ;; esac
# a folder is written to, or made in the nearest folder that is there
writable() {
  local place=$1
  while [ ! -e "$place" ] && [ ! -L "$place" ]; do place=$(dirname "$place"); done
  local probe
  [ -d "$place" ] && probe=$(mktemp "$place/.fiber_XXXXXX" 2>/dev/null) && rm "$probe"
}
writable "$clone" || refuse "$clone cannot be written to, and the build is made there: copy the clone elsewhere"
[ -n "$out" ] || refuse "OUT= is empty: name a folder"
writable "$out" || refuse "OUT=$out cannot be written to: choose another folder"
for files in "$@"; do
  IFS=, read -ra each <<<"$files"
  for file in "${each[@]}"; do
    [ -e "$file" ] && [ ! -d "$file" ] || refuse "$file: there is no such file"
  done
done
# a port without a listener is refused where there is a loopback interface
case $({ LC_ALL=C exec 3<>/dev/tcp/127.0.0.1/1; } 2>&1 || true) in
*unreachable*) refuse "the loopback interface is down, and the nodes talk over it: 'ip link set lo up'" ;;
esac
