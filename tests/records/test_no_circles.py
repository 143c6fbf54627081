"""No module imports itself through others, inside functions included; names for type annotations do not count."""

from graphlib import TopologicalSorter

import pytest

grimp = pytest.importorskip("grimp")

ABOVE = "cfid.console"  # its views still meet in circles of two modules


def test_no_module_imports_itself_through_others() -> None:
    graph = grimp.build_graph("cfid", exclude_type_checking_imports=True, cache_dir=None)
    modules = {module for module in graph.modules if not module.startswith(ABOVE)}
    imports = {module: modules & graph.find_modules_directly_imported_by(module) for module in modules}

    TopologicalSorter(imports).prepare()  # raises CycleError, which names the modules


def test_no_module_imports_the_whole_package() -> None:
    graph = grimp.build_graph("cfid", exclude_type_checking_imports=True, cache_dir=None)

    assert graph.find_modules_that_directly_import("cfid") == set()
