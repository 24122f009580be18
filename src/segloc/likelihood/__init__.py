"""Candidate poses -> a posterior: clouds compared at poses, scored, and set against each other."""

from .config import VerificationConfig as VerificationConfig
from .model import CHANCE_RIVAL as CHANCE_RIVAL
from .model import FEATURES as FEATURES
from .model import Model as Model
from .model import Promise as Promise
from .model import aligned_measures as aligned_measures
from .model import features_of as features_of
from .model import shipped_model as shipped_model
from .model import walls_over as walls_over
from .observation import Aligned as Aligned
from .observation import Count as Count
from .observation import Evidence as Evidence
from .observation import Observation as Observation
from .observation import QueryCloud as QueryCloud
from .posterior import Posterior as Posterior
from .posterior import ScoredPose as ScoredPose
from .posterior import log_odds as log_odds
from .registration import ERRORS as ERRORS
from .registration import Aligner as Aligner
from .registration import ErrorModel as ErrorModel
from .registration import Registered as Registered
from .registration import Target as Target
from .registration import thinned as thinned
from .scorer import Likelihood as Likelihood
from .scorer import Scorer as Scorer
from .scorer import Trial as Trial
