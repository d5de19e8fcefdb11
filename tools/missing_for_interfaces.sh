#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Print what is missing to build fiber_interfaces; nothing if it can be built.
# missing_for_interfaces.sh PYTHON
set -u
python=$1 missing=()
command -v cmake >/dev/null || missing+=("cmake")
command -v "${CXX:-c++}" >/dev/null || missing+=("a C++ compiler")
command -v make >/dev/null || command -v ninja >/dev/null || missing+=("make")
"$python" -c '
import os, sysconfig
raise SystemExit(not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")))
' || missing+=("the headers of Python")
generators=
IFS=: read -ra prefixes <<<"${AMENT_PREFIX_PATH:-}"
for prefix in "${prefixes[@]}"; do
  [ -d "$prefix/share/rosidl_default_generators" ] && generators=yes
done
[ -n "$generators" ] || missing+=("rosidl_default_generators")
IFS=,
[ ${#missing[@]} -eq 0 ] || echo "${missing[*]}" | sed 's/,/, /g'
