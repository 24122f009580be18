"""Diagnose recordings: measure their faults and name the remedies."""

from .body_in_view import body_findings as body_findings
from .faulty import faulty_points as faulty_points
from .finding import Fault as Fault
from .finding import Finding as Finding
from .pose_faults import pose_findings as pose_findings
from .recording import Examination as Examination
from .recording import examine as examine
from .recording import facts as facts
from .recording import first_fault as first_fault
from .recording import hint as hint
from .recording import map_finding as map_finding
from .recording import require_mappable as require_mappable
from .recording import sample_scans as sample_scans
from .revisits import revisit_findings as revisit_findings
from .revisits import session_findings as session_findings
from .scan_faults import scan_findings as scan_findings
