"""What tests of exports need to run a file by the tool that it is for."""

import importlib.util
import shutil
import subprocess

import pytest


def loaded(code, label):
    """Run written code of Python as a module of its own."""
    space = {"__name__": label}
    exec(compile(code, label, "exec"), space)
    return space


def need_tool(name):
    """Give the path of a program; skip where it is not there."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


def need_module(name):
    """Skip where a module is not there."""
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"{name} is not installed")


def run(*command, **options):
    """Run a program and give what it printed."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
