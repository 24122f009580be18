"""Candidate poses -> a posterior: clouds compared at poses, scored, and set against each other."""

from .config import VerificationConfig as VerificationConfig
from .model import FEATURES as FEATURES
from .model import Model as Model
from .model import shipped_model as shipped_model
from .observation import Aligned as Aligned
from .observation import Count as Count
from .observation import Evidence as Evidence
from .observation import Observation as Observation
from .observation import QueryCloud as QueryCloud
from .posterior import Posterior as Posterior
from .posterior import ScoredPose as ScoredPose
from .registration import ERRORS as ERRORS
from .registration import Aligner as Aligner
from .registration import ErrorModel as ErrorModel
from .registration import Registered as Registered
from .registration import Target as Target
from .registration import thinned as thinned
from .scorer import Likelihood as Likelihood
from .scorer import Scorer as Scorer
from .scorer import Trial as Trial
