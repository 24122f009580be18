"""Candidate poses -> a verdict: clouds compared at poses, rivals, confidence, decision."""

from .confidence import ConfidenceModel as ConfidenceModel
from .confidence import shipped_confidence as shipped_confidence
from .config import VerificationConfig as VerificationConfig
from .evidence import Evidence as Evidence
from .evidence import RefinedScore as RefinedScore
from .evidence import Score as Score
from .evidence import Verdict as Verdict
from .observation import QueryCloud as QueryCloud
from .verifier import Verifier as Verifier
