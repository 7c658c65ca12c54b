"""Compilation of numerical kernels with numba, and their cache on disk.

A law of motion is written once. Evaluated with float64 it gives the outcome; evaluated with complex128 and a step of
1e-30 along the imaginary axis it gives the derivative, exact to rounding (Squire and Trapp 1998,
doi:10.1137/S003614459631241X). Such a kernel branches on real parts only, and takes no abs, min or max of a value that
can be complex.

Compiled code is cached on disk and shared by processes. Numba's own cache key covers the file of a function only, so a
change in another file that the function calls would go unnoticed. Here the key covers every module that the module of
the function imports, directly or indirectly.

Numba copies the code of every function that a function calls into it, so that a function at the bottom of a chain of
calls is optimized and translated once per function above it. Here that holds for short functions only, which the
optimizer inlines. The code of a longer one exists once, and its callers refer to it by its symbol; they are loaded
from disk after it, and only if it still has this symbol.

Notification and timing of compilations: a new installation compiles all kernels, which takes a minute.

Copies of small arrays in compiled functions.

`target[:] = source` takes several times as long to compile: numba checks shapes and overlaps, and formats errors.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import islice
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numba
from filelock import FileLock
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.codegen import ll
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, Listener, TimingListener, install_listener, trigger_event
from numba.core.sigutils import normalize_signature
from numba.core.types.misc import unliteral

from models.core.module_discovery import find_discovered_packages, find_imports

# Length of the complex step, along the imaginary axis.
COMPLEX_STEP = 1e-30
# Packages whose compiled functions are cached on disk.
CACHED_PACKAGES = ("models.", "video.")
# Numba event of a process in which a cached function is compiled, or which waits while another one compiles it.
COMPILATION_EVENT = "trueroll:compilation"
# Instructions of a function beyond which its callers refer to its code. LLVM inlines about 55 (cost 275 at 5 each),
# more where arguments are constants. With 100, derivatives of Mathavan's model are 7 % slower; with 250, as fast as
# copied.
_MAX_COPIED_INSTRUCTIONS = 250


class _KernelReference(NamedTuple):
    """A compiled function that other compiled code refers to."""

    module: str
    name: str
    arguments: tuple[Any, ...]
    """Types of the arguments."""
    symbol: str


# Hexadecimal digits that tell closures apart: two of a thousand agree once in 10^9 programs.
_NAME_DIGITS = 12

# By library of compiled code: the functions that must be loaded before code into which it is linked.
_references: WeakKeyDictionary[Any, tuple[_KernelReference, ...]] = WeakKeyDictionary()


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


class _SharedCodeImpl(CompileResultCacheImpl):  # type: ignore[misc]
    """Saves and loads compiled functions together with references to the code that they call."""

    def reduce(self, cres: Any) -> Any:
        """Reduce a new compiled function to what is saved; its callers refer to its code from now on if it is long."""
        library, symbol = cres.library, cres.fndesc.mangled_name
        called = tuple(dict.fromkeys(ref for one in library._linking_libraries for ref in _find_references(one)))
        function = cres.fndesc
        own = _KernelReference(function.modname, function.qualname, tuple(function.argtypes), symbol)
        instructions = (one for block in library.get_function(symbol).blocks for one in block.instructions)
        is_long = next(islice(instructions, _MAX_COPIED_INSTRUCTIONS, None), None) is not None
        is_shared = is_long and isinstance(_find_kernel(own), Dispatcher)
        if is_shared:
            library._shared_module = ll.parse_assembly(str(library.codegen._create_empty_module(library.name)))
        _references[library] = (own,) if is_shared else called
        return called, own if is_shared else None, function.llvm_cpython_wrapper_name, super().reduce(cres)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Rebuild a saved compiled function; None if code that it calls has been compiled again since."""
        called, own, wrapper, reduced = payload
        for one in called:
            kernel = _find_kernel(one)
            if not isinstance(kernel, Dispatcher):
                return None
            kernel.compile(one.arguments)
            if kernel.overloads[one.arguments].fndesc.mangled_name != one.symbol:
                return None
        target_context.codegen()._engine._defined_symbols.add(wrapper)
        cres = super().rebuild(target_context, reduced)
        _references[cres.library] = called if own is None else (own,)
        return cres


class _SharedCodeCache(FunctionCache):  # type: ignore[misc]
    """The cache of a compiled function whose code can be shared."""

    _impl_class = _SharedCodeImpl

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


def _find_kernel(reference: _KernelReference) -> Any:
    """Find the compiled function of a reference; something else, or None, where it has another name in its module."""
    return getattr(sys.modules.get(reference.module), reference.name, None)


def _find_references(library: Any) -> tuple[_KernelReference, ...]:
    """Find the functions that code refers to into which a library is linked."""
    if library in _references:
        return _references[library]
    return tuple(ref for one in library._linking_libraries for ref in _find_references(one))


def compile_kernel(function: Callable[..., Any]) -> Any:
    """Compile a numerical function with numba; use as a decorator.

    Division by zero gives inf as in numpy, other threads run during a call, and sums keep their order. A constant as an
    argument counts as a number: numba would compile the function once more for every constant that it is called with,
    and for every variable that begins as one.

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
    find_code = kernel.get_call_template
    kernel.get_call_template = lambda args, names: find_code(
        [unliteral(one) for one in args], {name: unliteral(one) for name, one in names.items()}
    )
    if not function.__module__.startswith(CACHED_PACKAGES):
        return kernel
    try:
        cache_entry = _SharedCodeCache(function)
    except RuntimeError:  # no writable cache folder: every process compiles again
        return kernel
    cache_entry._cache_file = IndexDataCacheFile(
        cache_entry.cache_path, cache_entry._impl.filename_base, _hash_source_tree(function.__module__)
    )
    kernel._cache = cache_entry
    kernel.compile = _make_single_compilation(kernel, kernel.compile)
    return kernel


def is_compiled(kernel: Any) -> bool:
    """Find out whether a kernel was compiled before.

    Args:
        kernel: Result of `compile_kernel`.

    Returns:
        Whether compiled code of the present source is on disk, whatever the types of its arguments.
    """
    return isinstance(kernel._cache, FunctionCache) and bool(kernel._cache._cache_file._load_index())


def _make_single_compilation(kernel: Any, compile_now: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make the method `compile` of a kernel, which waits while another process compiles the same function.

    A process that waits holds locks of callers only, so no two processes wait for each other.
    """
    cache_entry = kernel._cache
    lock = cache_entry._cache_file._index_path.removesuffix(".nbi") + ".lock"

    def compile_once(signature: Any) -> Any:
        if tuple(normalize_signature(signature)[0]) in kernel.overloads:
            return compile_now(signature)
        with global_compiler_lock:
            key = cache_entry._index_key(signature, kernel.targetctx.codegen())
            if key in cache_entry._cache_file._load_index():
                return compile_now(signature)
            cache_entry._impl.locator.ensure_cache_path()
            with trigger_event(COMPILATION_EVENT), FileLock(lock):
                return compile_now(signature)

    return compile_once


def compile_inline_closure(function: Callable[..., Any]) -> Any:
    """Compile a closure inline, as a part of every compiled function that calls it.

    It is not cached on disk; the compiled functions that call it are.

    Args:
        function: A closure over compiled functions.

    Returns:
        The compiled closure.
    """
    return numba.njit(error_model="numpy", nogil=True, inline="always")(function)


@contextmanager
def notify_first_compilation(notify: Callable[[], None]) -> Iterator[None]:
    """Call `notify` once, before the first compilation of a function that is cached on disk.

    Args:
        notify: Called without arguments, in the thread that compiles.

    Yields:
        None; the notification is active inside the `with` block.
    """
    with install_listener(COMPILATION_EVENT, _CompilationListener(notify)):
        yield


class _CompilationListener(Listener):  # type: ignore[misc]
    """Listens to compilations of cached functions."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify: Callable[[], None] | None = notify

    def on_start(self, event: Event) -> None:
        if self._notify is not None:
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
    with install_listener(COMPILATION_EVENT, TimingListener()) as timer:
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
