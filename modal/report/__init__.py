"""A result as files that people read and programs load: HTML, Markdown, JSON, CSV, UFF 55 and the recording."""

from modal.report.discrepancy_writing import DiagnosisFiles
from modal.report.folder import write_pdf
from modal.report.writing import ReportFiles, write_report
from modal.sections.validation import Provenance, SourceFile, fingerprints

__all__ = ["DiagnosisFiles", "Provenance", "ReportFiles", "SourceFile", "fingerprints", "write_pdf", "write_report"]
