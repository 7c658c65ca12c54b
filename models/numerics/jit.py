"""Compilation of numerical kernels with numba, and their cache on disk.

A law of motion is written once. Evaluated with float64 it gives the outcome; evaluated with complex128 and a step of
1e-30 along the imaginary axis it gives the derivative, exact to rounding (Squire and Trapp 1998,
doi:10.1137/S003614459631241X). Such a kernel branches on real parts only, and takes no abs, min or max of a value that
can be complex.

Numba compiles a function again for every type of its arguments, and takes each Python integer, read-only array and
array that is not contiguous for a type of its own. So constants that are passed on are `np.int64`, and callers pass
contiguous arrays that can be written.

Compiled code is cached on disk and shared by processes. Numba's own cache key covers the file of a function only, so a
change in another file that the function calls would go unnoticed. Here the key covers every module that the module of
the function imports, directly or indirectly.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from multiprocessing import current_process
from typing import Any

import numba
from filelock import FileLock
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, Listener, TimingListener, install_listener

from models.core.module_discovery import find_discovered_packages, find_imports

# Length of the complex step, along the imaginary axis.
COMPLEX_STEP = 1e-30
# Packages whose compiled functions are cached on disk.
CACHED_PACKAGES = ("models.", "video.")
# Held by the thread that compiles or loads a function. Numba's own lock is taken after its timers have begun, which
# threads then disturb (https://github.com/numba/numba/issues/10564): a page that asks two things at once might fail.
_COMPILING = threading.RLock()
# Numba event of a process in which a function is compiled that the cache does not hold.
_COMPILATION_EVENT = "numba:compile"
# Hexadecimal digits that tell closures apart: two of a thousand agree once in 10^9 programs.
_NAME_DIGITS = 12


@cache
def _read_source(module: str) -> bytes | None:
    """Read the source of a module of `CACHED_PACKAGES`; None if there is no such file."""
    package, *folders, name = module.split(".")
    path = files(package).joinpath(*folders, f"{name}.py")
    return path.read_bytes() if path.is_file() else None


@cache
def _find_project_imports(module: str) -> frozenset[str]:
    """Find the modules of `CACHED_PACKAGES` that a module imports, by import statements or by discovery."""
    source, candidates = _read_source(module) or b"", set[str]()
    for _, package, names in find_imports(source):
        if package.startswith(CACHED_PACKAGES):
            candidates.update([package, *(f"{package}.{name}" for name in names)])
    for package in find_discovered_packages(source):
        root, *folders = package.split(".")
        candidates.update(_list_modules(files(root).joinpath(*folders), package))
    return frozenset(name for name in candidates if _read_source(name) is not None)


def _list_modules(folder: Traversable, package: str) -> Iterator[str]:
    """Yield the names of all modules in the folder of a package and in the folders below it."""
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _list_modules(entry, f"{package}.{entry.name}")
        elif entry.name.endswith(".py"):
            yield f"{package}.{entry.name.removesuffix('.py')}"


@cache
def _hash_source_tree(module: str) -> str:
    """Hash the sources of a module and of all modules of `CACHED_PACKAGES` that it imports, directly or indirectly."""
    modules, pending = {module}, [module]
    while pending:
        new = _find_project_imports(pending.pop()) - modules
        modules |= new
        pending += new
    digest = sha256()
    for name in sorted(modules):
        text = _read_source(name) or b""
        digest.update(f"{name} {len(text)} ".encode() + text)
    return digest.hexdigest()


class _SourceCache(FunctionCache):  # type: ignore[misc]
    """The cache of a compiled function, which holds as long as all the source that the function depends on."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = IndexDataCacheFile(
            self.cache_path, self._impl.filename_base, _hash_source_tree(function.__module__)
        )
        self._locks: dict[int, FileLock] = {}

    @property
    def _lock(self) -> FileLock:
        """Lock of the function, one of its own in every process: a lock that a fork inherits cannot be used."""
        process = current_process().pid or 0
        if process not in self._locks:
            self._locks[process] = FileLock(f"{self.cache_path}/{self._impl.filename_base}.lock")
        return self._locks[process]

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Load compiled code; without any, wait while another process compiles the function.

        A process that waits holds locks of callers only, so no two processes wait for each other.
        """
        code = super().load_overload(signature, target_context)
        if code is None:
            self._impl.locator.ensure_cache_path()
            self._lock.acquire()
            code = super().load_overload(signature, target_context)
            if code is not None:
                self._lock.release()
        return code

    def save_overload(self, signature: Any, code: Any) -> None:
        """Save compiled code, for which other processes may wait."""
        super().save_overload(signature, code)
        self._lock.release()

    @property
    def is_filled(self) -> bool:
        """Whether compiled code of the present source is on disk, whatever the types of its arguments."""
        return bool(self._cache_file._load_index())

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        """Return the key of a signature; numba would pickle what a closure encloses, differently in every process."""
        return signature, codegen.magic_tuple(), _describe_enclosed(self._py_func)


def _describe_enclosed(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Describe what a closure encloses: numbers, and compiled functions by all the source that they depend on."""
    values = (cell.cell_contents for cell in function.__closure__ or ())
    return tuple(
        (one.py_func.__qualname__, _hash_source_tree(one.py_func.__module__), _describe_enclosed(one.py_func))
        if isinstance(one, Dispatcher)
        else repr(one)
        for one in values
    )


def compile_kernel(function: Callable[..., Any]) -> Any:
    """Compile a numerical function with numba; use as a decorator.

    Division by zero gives inf as in numpy, other threads run during a call, and sums keep their order.

    Args:
        function: A function of numbers and arrays, which may enclose numbers and compiled functions.

    Returns:
        The compiled function. It is cached on disk if its module belongs to `CACHED_PACKAGES` and the cache folder is
        writable; otherwise every process compiles it again.
    """
    if enclosed := _describe_enclosed(function):
        # numba numbers its symbols per process: two closures of one name, compiled by two processes and loaded by a
        # third, would be linked as one
        function.__qualname__ += f"_{sha256(repr(enclosed).encode()).hexdigest()[:_NAME_DIGITS]}"
    kernel = numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True)(function)
    if function.__module__.startswith(CACHED_PACKAGES):
        with suppress(RuntimeError):  # no writable cache folder: every process compiles again
            kernel._cache = _SourceCache(function)
    compile_alone = kernel.compile

    def compile_in_turn(signature: Any) -> Any:
        with _COMPILING:
            return compile_alone(signature)

    kernel.compile = compile_in_turn
    return kernel


def is_compiled(kernel: Any) -> bool:
    """Find out whether a kernel was compiled before, for any types of its arguments.

    Args:
        kernel: Result of `compile_kernel`.

    Returns:
        Whether compiled code of the present source is on disk.
    """
    return isinstance(kernel._cache, _SourceCache) and kernel._cache.is_filled


@contextmanager
def notify_first_compilation(notify: Callable[[], None]) -> Iterator[None]:
    """Call `notify` once, before the first compilation of a function that is cached on disk.

    Args:
        notify: Called without arguments, in the thread that compiles.

    Yields:
        None; the notification is active inside the `with` block.
    """
    with install_listener(_COMPILATION_EVENT, _CompilationListener(notify)):
        yield


class _CompilationListener(Listener):  # type: ignore[misc]
    """Listens to compilations of cached functions."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify: Callable[[], None] | None = notify

    def on_start(self, event: Event) -> None:
        if self._notify is not None and isinstance(event.data["dispatcher"]._cache, _SourceCache):
            notify, self._notify = self._notify, None
            notify()

    def on_end(self, event: Event) -> None:
        return None


@contextmanager
def measure_compilation() -> Iterator[Callable[[], float]]:
    """Measure for how long this process compiles functions that are cached on disk, or waits for them.

    Yields:
        A function that returns the time since the `with` block began, s.
    """
    with install_listener(_COMPILATION_EVENT, TimingListener()) as timer:
        yield lambda: timer.duration if timer.done else 0.0


@compile_kernel
def copy_numbers(source, target):  # type: ignore[no-untyped-def]
    """Copy an array (n,) to the first n numbers of another, which it does not overlap."""
    for k in range(len(source)):
        target[k] = source[k]


@compile_kernel
def copy_rows(source, target):  # type: ignore[no-untyped-def]
    """Copy an array (n, m) to the first n rows of another, which it does not overlap."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
