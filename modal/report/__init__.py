"""A result as files that people read and programs load: HTML, Markdown, JSON, CSV and the recording."""

from modal.report.provenance import Provenance
from modal.report.writing import DiagnosisFiles, ReportFiles, write_report

__all__ = ["DiagnosisFiles", "Provenance", "ReportFiles", "write_report"]
