"""The registry of student kinds: one line and one folder per kind. The code is a class like `Student` in student.py."""

from acgd.settings import Kind

STUDENTS: dict[str, Kind] = {
    "acgd": Kind("acgd.students.acgd.settings:ACGDConfig", "acgd.students.acgd.model:ACGD"),
    "bc": Kind("acgd.students.bc.settings:BCConfig", "acgd.students.bc.model:BC"),
}
