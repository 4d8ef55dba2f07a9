"""The paper's transfer table in the original task, PyBullet's: every arm at a base moved by one x towards the table.

`docs/original_task.md` says what is asked, by which rule it is answered, and how to run it. It needs PyBullet, which
the project does not depend on.
"""
