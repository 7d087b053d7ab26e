"""Slurm's commands as far as submitit needs them: the jobs of an array are processes of this machine."""

import stat
import sys
from pathlib import Path

#: keeps the submitted script beside the commands, starts its tasks, and does not wait for them; it knows no
#: partition "nowhere"
SBATCH = """
import os, re, subprocess, sys
from pathlib import Path
script = Path(sys.argv[-1])
text = script.read_text()
here = Path(__file__).parent
if "partition=nowhere" in text:
    sys.exit("sbatch: error: invalid partition specified: nowhere")
(here / "submitted.sh").write_text(text)
last = int(re.search(r"--array=0-(\\d+)", text).group(1))
for task in range(last + 1):
    environment = dict(
        os.environ, SLURM_JOB_ID=f"7_{task}", SLURM_ARRAY_JOB_ID="7", SLURM_ARRAY_TASK_ID=str(task),
        SLURM_NTASKS="1", SLURM_PROCID="0", SLURM_LOCALID="0", SLURM_NODEID="0", SLURM_JOB_NUM_NODES="1",
        SLURM_JOB_NODELIST="here",
    )
    log = open(here / f"task{task}.log", "w")
    subprocess.Popen(["bash", str(script)], env=environment, stdout=log, stderr=log, start_new_session=True)
print("Submitted batch job 7")
"""
#: drops its own options, each with its value or with `=` in it, and does what is left
SRUN = """
import os, sys
words = sys.argv[1:]
while words[0].startswith("-"):
    word = words.pop(0)
    if "=" not in word and word != "--unbuffered":
        words.pop(0)
os.execvp(words[0], words)
"""
SACCT = """
print("JobID|State|NodeList")
"""


def write(folder: Path) -> Path:
    """Put sbatch, srun and sacct into a folder, which then goes to the front of PATH."""
    folder.mkdir(parents=True)
    for name, text in (("sbatch", SBATCH), ("srun", SRUN), ("sacct", SACCT)):
        path = folder / name
        path.write_text(f"#!{sys.executable}\n{text}")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return folder
