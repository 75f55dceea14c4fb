"""The registry of student kinds: one line and one folder per kind. The code is a class like `Student` in student.py."""

from acgd.settings import Kind

STUDENTS: dict[str, Kind] = {
    "acgd": Kind("acgd.students.acgd.settings:ACGDConfig", "acgd.students.acgd.model:ACGD"),
    "act": Kind("acgd.students.act.settings:ACTConfig", "acgd.students.act.model:ACT"),
    "bc": Kind("acgd.students.bc.settings:BCConfig", "acgd.students.bc.model:BC"),
    "bc_rnn": Kind("acgd.students.bc_rnn.settings:BCRNNConfig", "acgd.students.bc_rnn.model:BCRNN"),
    "chunk": Kind("acgd.students.chunk.settings:ChunkConfig", "acgd.students.chunk.model:Chunk"),
}
