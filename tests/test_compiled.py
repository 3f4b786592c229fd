"""Kernels are registered when declared, compiled on demand, and never again after the warm-up."""

import subprocess
import sys
from pathlib import Path

# Each script runs in a process of its own: a warm-up forbids compiling for the rest of the process.
DECLARE = """
import numpy as np
from companion import compiled as registry
from companion.compiled import compiled, inlined, warm_up

@inlined
def doubled(x):
    return 2.0 * x

@compiled("void(float64[::1], float64[::1])")
def scale(values, out):
    for index in range(len(values)):
        out[index] = doubled(values[index])

@compiled("float64(float64, float64)")
def quotient(numerator, denominator):
    return numerator / denominator

out = np.empty(3)
"""


def run(folder: Path, script: str, **variables: str) -> str:
    """Return what a script prints; it lives in a file, as cached kernels must."""
    path = folder / "kernels.py"
    path.write_text(DECLARE + script)
    result = subprocess.run(
        [sys.executable, str(path)],
        env={
            "NUMBA_CACHE_DIR": str(folder / "cache"),
            "PYTHONPATH": str(Path(__file__).parents[1]),
            **variables,
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_declaring_registers_a_kernel_and_compiles_nothing(tmp_path: Path) -> None:
    script = """
for dispatcher, signature in registry._registry:
    print(dispatcher.py_func.__name__, signature)
assert scale.signatures == quotient.signatures == doubled.signatures == []
"""
    assert run(tmp_path, script).splitlines() == [
        "scale void(float64[::1], float64[::1])",
        "quotient float64(float64, float64)",
    ]
    assert not list(tmp_path.rglob("*.nbc"))


def test_the_warm_up_makes_every_kernel_ready_for_its_one_signature_and_no_other(tmp_path: Path) -> None:
    script = """
seen = []
assert warm_up(lambda *progress: seen.append(progress)) == 2
assert seen == [("scale", 1, 2), ("quotient", 2, 2)], seen
scale(np.array([1.0, 2.0, 3.0]), out)
assert out.tolist() == [2.0, 4.0, 6.0]
for wrong in (np.arange(3, dtype=np.float32), np.arange(6.0)[::2]):
    try:
        scale(wrong, out)
    except TypeError:
        print("refused")
assert warm_up() == 2
assert len(scale.signatures) == len(quotient.signatures) == 1
"""
    assert run(tmp_path, script).splitlines() == ["refused", "refused"]


def test_before_the_warm_up_a_first_call_compiles_that_kernel_alone(tmp_path: Path) -> None:
    script = """
assert quotient(1.0, 4.0) == 0.25
assert len(quotient.signatures) == 1
assert scale.signatures == []
"""
    run(tmp_path, script)


def test_kernels_divide_by_zero_like_ieee_754_and_let_other_threads_run(tmp_path: Path) -> None:
    script = """
assert quotient(1.0, 0.0) == np.inf
assert np.isnan(quotient(0.0, 0.0))
assert all(dispatcher.targetoptions["nogil"] for dispatcher, _ in registry._registry)
"""
    run(tmp_path, script)


def test_a_second_process_loads_from_the_disk_what_the_first_compiled(tmp_path: Path) -> None:
    script = """
warm_up()
print(sum(sum(kernel.stats.cache_hits.values()) for kernel in (scale, quotient)))
print(sum(sum(kernel.stats.cache_misses.values()) for kernel in (scale, quotient)))
"""
    assert run(tmp_path, script).split() == ["0", "2"]
    assert run(tmp_path, script).split() == ["2", "0"]


def test_a_first_call_loads_what_a_warm_up_compiled_and_the_other_way_round(tmp_path: Path) -> None:
    script = """
import os

if os.environ["FIRST"] == "warm-up":
    warm_up()
else:
    scale(np.ones(3), out)
    quotient(1.0, 4.0)
print(sum(sum(kernel.stats.cache_misses.values()) for kernel in (scale, quotient)))
"""
    for order in (("warm-up", "call"), ("call", "warm-up")):
        folder = tmp_path / order[0]
        folder.mkdir()
        assert [run(folder, script, FIRST=first).strip() for first in order] == ["2", "0"]


def test_a_kernel_that_returns_another_type_than_it_declares_is_refused_by_name(tmp_path: Path) -> None:
    script = """
@compiled("int64(float64)")
def halved(x):
    return 0.5 * x

try:
    warm_up()
except TypeError as error:
    print(error)
"""
    assert run(tmp_path, script) == "halved returns float64, declared is int64\n"


def test_the_same_source_runs_on_a_card_even_if_the_processor_may_compile_no_more(tmp_path: Path) -> None:
    script = """
from numba import cuda
from companion.compiled import for_cuda

warm_up()

def scale_own(values, out):
    place = cuda.grid(1)
    if place < out.shape[0]:
        scale(values[place:place + 1], out[place:place + 1])

values = np.array([1.0, 2.0, 3.0])
for_cuda(scale_own, entry=True)[2, 2](values, out)
print(out.tolist())
twin = for_cuda(scale)
print(type(twin).__name__, type(twin.__globals__["doubled"]).__name__)
"""
    lines = run(tmp_path, script, NUMBA_ENABLE_CUDASIM="1").splitlines()
    assert lines == ["[2.0, 4.0, 6.0]", "function function"]


def test_functions_for_a_card_are_built_once_and_never_from_what_the_processor_runs(tmp_path: Path) -> None:
    script = """
from companion.compiled import for_cuda

first, second = for_cuda(scale), for_cuda(scale)
inner = first.py_func.__globals__["doubled"]
print(type(first).__name__, inner is second.py_func.__globals__["doubled"], inner is doubled)
print(scale.__globals__["doubled"] is doubled if hasattr(scale, "__globals__") else doubled.py_func(1.5))
"""
    assert run(tmp_path, script).splitlines() == ["CUDADispatcher True False", "3.0"]


PORTABLE = """
from companion.compiled import portable, portable_inlined

@portable_inlined
def row_of(k, rows, labels):
    return rows[k], labels

@portable("float64(int64, float64[:,::1], float64[::1])")
def taken(k, rows, labels):
    row, _ = row_of(k, rows, labels)
    return row[0]

@portable("float64(int64)")
def made(size):
    return np.zeros(size)[0]

@portable_inlined
def spoil(size):
    return np.zeros(size)[0]

@compiled("float64(int64)")
def calls(size):
    return spoil(size)
"""


def test_portable_kernels_hand_arrays_on_without_counting_who_holds_them(tmp_path: Path) -> None:
    script = """
import sys
rows = np.arange(12.0).reshape(6, 2)
before = sys.getrefcount(rows)
print(sum(taken(k % 6, rows, out) for k in range(6000)), sys.getrefcount(rows) - before)
assembly = taken.inspect_asm(taken.signatures[0])
print("NRT_" in assembly)
"""
    assert run(tmp_path, PORTABLE + script).splitlines() == ["30000.0 0", "False"]


def test_portable_kernels_that_allocate_are_not_compiled(tmp_path: Path) -> None:
    script = """
from numba.core.errors import NumbaError

for kernel in (made, calls):
    try:
        kernel(3)
    except NumbaError:
        print("refused")
"""
    assert run(tmp_path, PORTABLE + script).splitlines() == ["refused", "refused"]
