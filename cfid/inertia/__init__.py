"""The inertia matrix from swings about six axes or more; the test body compared with its drawing."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.inertia.result import fit as fit
    from cfid.inertia.testbody_result import fit_testbody as fit_testbody

__getattr__, __dir__ = attached(__name__, {"fit": "result", "fit_testbody": "testbody_result"})
