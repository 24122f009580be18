"""Candidate poses -> a verdict: clouds compared at poses, rivals, confidence, decision."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy
from .confidence import ConfidenceModel as ConfidenceModel
from .confidence import shipped_confidence as shipped_confidence
from .config import VerificationConfig as VerificationConfig
from .evidence import Evidence as Evidence
from .evidence import RefinedScore as RefinedScore
from .evidence import Score as Score
from .evidence import Verdict as Verdict
from .observation import QueryCloud as QueryCloud
from .verifier import Verifier as Verifier

if TYPE_CHECKING:
    from .confidence import CAUTIOUS_FEATURES as CAUTIOUS_FEATURES
    from .confidence import FEATURES as FEATURES
    from .decision import CAUTIOUSLY as CAUTIOUSLY
    from .decision import REPEATED_ROOT as REPEATED_ROOT
    from .decision import demand as demand
    from .decision import equal_rival as equal_rival
    from .registration import ERRORS as ERRORS
    from .registration import Aligner as Aligner
    from .registration import ErrorModel as ErrorModel
    from .registration import Registered as Registered
    from .registration import Target as Target
    from .registration import thinned as thinned
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "confidence": "CAUTIOUS_FEATURES FEATURES",
            "decision": "CAUTIOUSLY REPEATED_ROOT demand equal_rival",
            "registration": "Aligner Registered Target thinned ERRORS ErrorModel",
        },
    )
