"""Compiled kernels are never older than what they were made from, whatever file that is in."""

import ast
import importlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from polyida import jit
from polyida.jit import cache as kernel_cache
from polyida.jit import entry

faster = pytest.mark.skipif(jit.compilers is None, reason="numba's own compilers keep code in files of their own, or do not keep it")
PACKAGE = Path(kernel_cache.__file__).parents[1]
CALLED = "from polyida.jit import part, shared\n\n@part\ndef inner(x):\n    return x + {}\n\n@shared\ndef called(x):\n    return inner(x)\n"
CALLER = (
    "from polyida.called import called, inner\nfrom polyida.jit import entry\n\n@entry\ndef call(x):\n    return called(x) + inner(x)\n"
)
SAY = "import polyida.caller as c; print(c.call(1), sum(c.call.stats.cache_hits.values()), c.call._cache.cache_path)"


@pytest.fixture
def chain(tmp_path):
    """(package, say): a package of one entry that calls a shared function and a part in another file; say() runs it in new processes."""
    package = tmp_path / "polyida"
    package.mkdir()
    shutil.copytree(PACKAGE / "jit", package / "jit", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(PACKAGE / "clock.py", package)
    (package / "__init__.py").write_text("")
    (package / "caller.py").write_text(CALLER)
    (package / "called.py").write_text(CALLED.format(1))

    def say(processes=1, **environment):
        own = {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "user"), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": ""}
        settings = os.environ | own | environment
        started = [
            subprocess.Popen([sys.executable, "-c", SAY], env=settings, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
            for _ in range(processes)
        ]
        answers = [process.communicate()[0].split() for process in started]
        return [(int(value), int(hits), Path(path)) for value, hits, path in answers]

    return package, say


def test_a_kernel_edited_in_another_file_is_compiled_anew_and_the_old_one_is_kept(chain):
    """Also where a file of a function that it calls is missing."""
    package, say = chain
    (value, _, folder), other = say(processes=2)
    assert value == other[0] == 4, "at once with an empty cache, whoever fills it"
    (package / "called.py").write_text(CALLED.format(2))
    assert say()[0][:2] == (6, 0)
    (package / "called.py").write_text(CALLED.format(1))
    assert say()[0][:2] == (4, 1), "back at the first sources: nothing is compiled"
    kept = list(folder.glob("called.called-*"))
    for path in kept:
        path.unlink()
    assert kept and say()[0][:2] == (4, 1)


@faster
def test_two_processes_that_compile_at_once_do_not_mix_up_signatures(tmp_path, monkeypatch):
    """Two entries of one function stand for two processes; the second writes its code while the first is between its files."""

    def double(x):
        return 2 * x

    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    first, second, replace, late, calls = entry(double), entry(double), os.replace, [], []

    def replaced(source, target):
        calls.append(target)
        if len(calls) == 1:
            assert second(1.5) == 3.0
        if len(calls) > 1 and not late and not str(target).endswith(".nbi"):
            late.append((source, target))  # the second one's code comes last
        else:
            replace(source, target)

    monkeypatch.setattr(os, "replace", replaced)
    assert first(1) == 2
    for source, target in late:
        replace(source, target)
    monkeypatch.undo()
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    fresh = entry(double)
    assert (fresh(1.5), fresh(1)) == (3.0, 2)
    assert sum(fresh.stats.cache_hits.values()) == 2


@faster
def test_processors_have_code_of_their_own(chain):
    """A folder that several kinds of machine share, or that a run for another processor fills, gives none of them another's code."""
    _, say = chain
    answers = [say(NUMBA_CPU_NAME=processor)[0] for processor in ("generic", "core2", "generic")]
    assert [value for value, *_ in answers] == [4] * 3
    assert [hits for _, hits, _ in answers] == [0, 0, 1] and len({folder for *_, folder in answers}) == 1


@faster
@pytest.mark.parametrize("damage", [b"", b"no pickle", None])
def test_a_damaged_file_is_compiled_anew(tmp_path, monkeypatch, damage):
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)

    def triple(x):
        return 3 * x

    assert entry(triple)(1.0) == 3.0
    (path,) = tmp_path.rglob("*.nbc")
    path.write_bytes(path.read_bytes()[:200] if damage is None else damage)
    fresh = entry(triple)
    assert fresh(1.0) == 3.0 and not fresh.stats.cache_hits
    again = entry(triple)
    assert again(1.0) == 3.0 and sum(again.stats.cache_hits.values()) == 1


def test_the_folder_is_where_numba_was_told_or_where_files_can_be_written(chain, tmp_path):
    package, say = chain
    assert say(NUMBA_CACHE_DIR=str(tmp_path / "own"))[0][2].is_relative_to(tmp_path / "own")
    shutil.rmtree(package / "__pycache__", ignore_errors=True)
    (package / "__pycache__").write_text("no folder")
    assert say()[0][2].is_relative_to(tmp_path / "user")


def test_numba_itself_and_the_sources_change_the_name(monkeypatch, tmp_path):
    (tmp_path / "a.py").write_text("import numba\n")
    (tmp_path / "b.py").write_text("import os\n")
    first = kernel_cache._digest(tmp_path)
    (tmp_path / "b.py").write_text("import sys\n")
    assert kernel_cache._digest(tmp_path) == first, "b.py makes no kernel"
    (tmp_path / "a.py").write_text("import numba \n")
    second = kernel_cache._digest(tmp_path)
    monkeypatch.setattr(kernel_cache.numba, "__version__", "0.0")
    assert len({first, second, kernel_cache._digest(tmp_path)}) == 3


def test_old_folders_go_but_not_those_just_used(tmp_path):
    now, ages = time.time(), [0.0, 10.0, *(kernel_cache.UNUSED * k for k in range(2, 9))]
    for k, age in enumerate(ages):
        (tmp_path / f"kernels-{k}").mkdir()
        os.utime(tmp_path / f"kernels-{k}", (now - age, now - age))
    kernel_cache._remove_old(tmp_path, "kernels-0")
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == [f"kernels-{k}" for k in range(kernel_cache.OLD_FOLDERS + 1)]


def test_every_file_that_kernels_are_made_of_is_in_the_hash():
    """Names that a decorated function uses come from its own file or from another one of the hash."""
    hashed = {Path(path) for path, _ in kernel_cache.sources(PACKAGE)}
    found = [_foreign(path, hashed) for path in hashed]
    assert sum(count for count, _ in found) > 100, "the decorated functions"
    assert [name for _, names in found for name in names] == []


def _foreign(path, hashed):
    """(number of decorated functions, names that they take from files of the package that are not hashed)."""
    tree, sources = ast.parse(path.read_text()), {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module.startswith("polyida"):
            sources |= {(alias.asname or alias.name): _file(node.module, alias.name) for alias in node.names}
    compiled = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.decorator_list]
    plain = {"named_keywords", "cache", "loading"}  # decorators of Python functions
    kernels = [node for node in compiled if not plain & {getattr(name, "id", "") for name in node.decorator_list}]
    used = {name for kernel in kernels for name in _used(kernel)}
    return len(kernels), [(path.name, name) for name in used & set(sources) if sources[name] not in hashed]


def _used(kernel):
    """Names that a function has from outside."""
    own = {argument.arg for argument in kernel.args.args}
    return {name.id for name in ast.walk(kernel) if isinstance(name, ast.Name)} - own


def _file(module, name):
    """The file that `from module import name` reads."""
    place = PACKAGE.parent.joinpath(*module.split("."), name)
    if place.with_suffix(".py").exists() or (place / "__init__.py").exists():
        module = f"{module}.{name}"
    return Path(importlib.import_module(module).__file__)


@faster
def test_names_of_shared_kernels_do_not_depend_on_the_order_of_sets():
    """Code that is kept on disk calls them by name: a process with another order would end with LLVM's "Symbol not found"."""
    program = "from polyida.jit.compilers import Options; x = Options(); x.fastmath = {'contract', 'reassoc', 'nsz'}; print(x.get_mangle_string())"
    seeds = [os.environ | {"PYTHONHASHSEED": seed} for seed in ("1", "2")]  # of other orders
    names = {subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True).stdout for env in seeds}
    assert len(names) == 1
