# SPDX-License-Identifier: Apache-2.0
"""What the project uses of numba: a compiled function is called like the Python function."""

from collections.abc import Callable
from typing import Any, Literal, TypeVar, overload

_Function = TypeVar("_Function", bound=Callable[..., Any])

@overload
def njit(function: _Function, /) -> _Function: ...
@overload
def njit(
    *,
    cache: bool = ...,
    error_model: Literal["python", "numpy"] = ...,
    fastmath: bool = ...,
    inline: Literal["never", "always"] = ...,
    no_cfunc_wrapper: bool = ...,
    no_cpython_wrapper: bool = ...,
    nogil: bool = ...,
) -> Callable[[_Function], _Function]: ...
