import subprocess
import sys

import pytest

import samira_warp


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    ).stdout.strip()


def test_importing_the_package_loads_neither_torch_nor_warp():
    loaded = run(
        "import sys, samira_warp; loaded = {name.split('.')[0] for name in sys.modules}; "
        "print(sorted(loaded & {'torch', 'warp', 'numpy', 'kornia'}))"
    )
    assert loaded == "[]"


def test_importing_every_module_compiles_and_starts_nothing():
    code = (
        "import importlib, pkgutil, samira_warp, warp as wp\n"
        "def refuse(*arguments, **options): raise SystemExit('Warp was started by an import')\n"
        "wp.init = wp.load_module = wp.launch = refuse\n"
        "modules = pkgutil.walk_packages(samira_warp.__path__, 'samira_warp.')\n"
        "names = [module.name for module in modules if not module.name.endswith('__main__')]\n"
        "[importlib.import_module(name) for name in names]\n"
        "print(len(names))"
    )
    assert int(run(code)) > 50


def test_public_names_come_from_their_homes():
    from samira_warp.avatar import Avatar
    from samira_warp.geometry.camera import Camera
    from samira_warp.light import Environment

    assert (samira_warp.Avatar, samira_warp.Camera, samira_warp.Environment) == (Avatar, Camera, Environment)
    for name in samira_warp.__all__:
        assert getattr(samira_warp, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = samira_warp.no_such_name


def test_user_errors_are_one_line_and_value_errors():
    error = samira_warp.UserError("a.json", expected="one\n  line", found="two\nlines")
    assert str(error) == "a.json: expected one line, found two lines"
    assert isinstance(error, ValueError)
