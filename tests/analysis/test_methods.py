"""The tables of methods and the options that ``fit_*`` name."""

import ast
import inspect
import re

import pytest

import analysis
from analysis import fit_sphere
from analysis.adjustment.weights import EFFICIENT_THRESHOLDS

FUNCTIONS = {
    analysis.fit_sphere: analysis.SPHERE_METHODS,
    analysis.fit_plane: analysis.PLANE_METHODS,
    analysis.fit_ellipse: analysis.ELLIPSE_METHODS,
    analysis.fit_elliptic_cylinder: analysis.CYLINDER_METHODS,
}
SHARED = fit_sphere.__doc__
NOT_OPTIONS = {"cloud", "printed_problem", "seed"}


@pytest.mark.parametrize("fit", FUNCTIONS, ids=lambda fit: fit.__name__)
def test_help_names_every_option_of_every_method_with_its_default(fit):
    """The thresholds of the robust fit are None in its signature: they stand for IGG III."""
    stated = re.findall(r"(\w+)=([^\s,();.]+(?:\.\d+)?)", f"{fit.__doc__} {SHARED}")
    defaults = {(name, ast.literal_eval(value)) for name, value in stated}
    for method in FUNCTIONS[fit].values():
        for name, option in inspect.signature(method.function).parameters.items():
            if name not in NOT_OPTIONS:
                thresholds = dict(zip(("k0", "k1"), EFFICIENT_THRESHOLDS, strict=True))
                expected = thresholds.get(name) if option.default is None else option.default
                assert (name, expected) in defaults, (method.label, name)


def test_a_method_that_takes_a_seed_says_so():
    for methods in FUNCTIONS.values():
        for method in methods.values():
            assert method.seeded == ("seed" in inspect.signature(method.function).parameters)
