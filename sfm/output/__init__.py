"""Models and maps as files for other programs, figures and pages."""
