"""Suites say what is to be run; cells are named by content."""

import dataclasses
import re
import subprocess
import sys

import pytest

from deadreckon import UserError, imports
from deadreckon.bench.jobs import Program, agent_of, turns
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import names, queue, read
from deadreckon.bench.work import perform
from deadreckon.cli.main import main
from deadreckon.online import Online

SMALL = """
kind = "learn"
seeds = 3
steps = 40
evaluations = 2
episodes = 2
logs = ["maze2d-umaze-v1"]
rows = 600

[methods]
BC = { agent = "bc", fields = { hidden = [8] } }
CQL = { agent = "cql", preset = true }
"""


@pytest.fixture
def written(tmp_path):
    def write(text, name="small"):
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        return path

    return write


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_every_suite_of_the_package_can_be_planned(name):
    suite = read(name)
    jobs = plan(suite)
    assert suite.about
    assert len(jobs) == len(suite.methods) * len(suite.on)
    cells = [cell for job in jobs for cell in job.cells]
    assert len(set(cells)) == len(cells) == len(jobs) * suite.seeds
    assert len({job.name for job in jobs}) == len(jobs)


def test_an_agent_is_the_same_however_it_is_spelled(written):
    spelled = SMALL.replace('"bc"', '"BC"').replace('"cql"', '"td3-bc"').replace("preset = true", "fields = { hidden = [8] }")
    usual = spelled.replace("td3-bc", "td3_bc").replace('"BC"', '"bc"')
    found = plan(read(written(spelled)))
    assert [job.agent for job in found] == ["bc", "td3_bc"]
    assert [job.cells for job in found] == [job.cells for job in plan(read(written(usual, "usual")))]


def test_the_thesis_has_suites():
    assert {"bear", "d4rl-gym", "d4rl-maze2d", "d4rl-rest", "dope", "mbpo", "nemo", "quick"} <= set(names())


def test_a_plan_holds_settings_presets_and_data(written):
    bc, cql = plan(read(written(SMALL)))
    assert (bc.settings["hidden"], bc.data) == ([8], "maze2d-umaze-v1@dr1-600-steps")
    assert bc.options == {"steps": 40, "episodes": 2, "every": 20}
    assert agent_of(bc).hidden == (8,)
    assert cql.preset == "maze2d"
    assert cql.settings["lagrange"] is True


def test_cells_are_named_by_all_that_their_numbers_depend_on(written):
    job = plan(read(written(SMALL)))[0]
    others = [
        dataclasses.replace(job, settings=job.settings | {"lr": 0.5}), dataclasses.replace(job, data="another"),
        dataclasses.replace(job, options=job.options | {"steps": 41}), dataclasses.replace(job, agent="td3"),
    ]  # fmt: skip
    assert len({job.cell(0), job.cell(1), *(other.cell(0) for other in others)}) == 6
    whole = plan(read(written(SMALL.replace("hidden = [8]", "hidden = [8], lr = 1"))))[0]
    assert whole.cell(0) == plan(read(written(SMALL.replace("hidden = [8]", "hidden = [8], lr = 1.0"))))[0].cell(0)
    # What a table calls it changes nothing, nor does which seeds share its program.
    assert dataclasses.replace(job, method="cloning", seeds=(0, 1)).cell(0) == job.cell(0)
    assert dataclasses.replace(job, revisions={}).cell(0) != job.cell(0)
    assert dataclasses.replace(job, revisions={}).content(0) == job.content(0)


@pytest.mark.slow  # cells of the ledger, which other processes made, are found by the tests of the evidence
def test_names_are_the_same_in_every_process(written):
    path = written(SMALL)
    told = "from deadreckon.bench.plan import plan; from deadreckon.bench.suite import read; import sys; "
    told += "print([job.cells for job in plan(read(sys.argv[1]))])"
    out = subprocess.run([sys.executable, "-c", told, path], capture_output=True, text=True, check=True).stdout
    assert out.strip() == str([job.cells for job in plan(read(path))])


def test_a_study_has_no_lanes(written):
    text = 'kind = "study"\nseeds = 2\nlanes = 4\ncases = ["a"]\nmetrics.error.words = "e"\n[methods]\nA = { agent = "x:f" }'
    with pytest.raises(UserError, match="unknown key of a suite of kind study 'lanes'"):
        read(written(text))


@pytest.mark.parametrize(("kind", "on", "agent", "names"), [
    ("design", "problems = ['branin']", "forward", ("lr", "learning_rate")),
    ("ope", "logs = ['hopper-medium-v2']", "fqe", ("lr", "learning_rate")),
])  # fmt: skip
def test_cells_are_the_same_by_whatever_name_of_a_field(kind, on, agent, names, written):
    suite = f"kind = '{kind}'\nseeds = 1\n{on}\n[methods]\nA = {{{{ agent = '{agent}', fields = {{{{ {{}} = 0.01 }}}} }}}}"
    one, other = (plan(read(written(suite.format(name))))[0] for name in names)
    assert one.cells == other.cells


def test_lanes_split_seeds_into_jobs(written):
    jobs = plan(read(written(SMALL.replace("seeds = 3", "seeds = 5\nlanes = 2"))))
    assert [job.seeds for job in jobs[:3]] == [(0, 1), (2, 3), (4,)]


def test_steps_may_differ_by_log(written):
    two = SMALL.replace('["maze2d-umaze-v1"]', '["maze2d-umaze-v1", "maze2d-medium-v1"]')
    jobs = plan(read(written(two.replace("steps = 40", "steps = { maze2d-umaze-v1 = 40, maze2d-medium-v1 = 60 }"))))
    assert [job.options["steps"] for job in jobs] == [40, 40, 60, 60]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seeds = 3", "sedes = 3", "unknown key of a suite of kind learn 'sedes': did you mean seeds"),
        ("seeds = 3", "seeds = 0", "seeds must be a whole number of 1 or more, got 0"),
        ("seeds = 3", "seeds = true", "seeds must be a whole number of 1 or more, got True"),
        ("steps = 40", "steps = { maze2d-medium-v1 = 40 }", "steps must be one number, or name each of maze2d-umaze-v1"),
        ("evaluations = 2", "evaluations = 50", "50 evaluations are more than its 40 steps"),
        ("steps = 40\nevaluations = 2", "steps = 5", "10 evaluations are more than its 5 steps"),
        ('kind = "learn"', 'kind = "lern"', "kind must be one of learn, online, design, ope, study, got 'lern'"),
        ('logs = ["maze2d-umaze-v1"]', "logs = []", "logs must be a list of different names"),
        ('agent = "bc", ', "", "method 'BC' must say its agent"),
        ('agent = "bc", ', 'agent = "bc", preset = 1, ', "preset of method 'BC' must be a bool, got 1"),
        ('agent = "bc", ', 'agent = "bc", felds = 1, ', "unknown key of method 'BC' 'felds': did you mean fields"),
        ("rows = 600", "designs = 5", "unknown key of a suite of kind learn 'designs'"),
        ("seeds = 3", "seeds = ", "is not TOML"),
    ],
)
def test_wrong_suites_are_refused_in_one_line(written, old, new, message):
    assert old in SMALL
    with pytest.raises(UserError, match=r"small\.toml") as error:
        read(written(SMALL.replace(old, new)))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("log", ["/etc/passwd", "../../x.csv", "a/../../x.csv", "~/x", "C:\\\\x", "..\\\\x", "a\\n"])
def test_logs_that_lie_elsewhere_are_not_read(written, log):
    with pytest.raises(UserError, match=r"small\.toml: log .* leads elsewhere; .*: put the log, or a link to it, there"):
        read(written(SMALL.replace("maze2d-umaze-v1", log)))
    with pytest.raises(UserError, match="leads elsewhere"):
        read(written(f'kind = "online"\ntasks = ["a"]\ndata = {{ a = "{log}" }}\n[methods]\nA = {{ agent = "sac" }}\n'))


@pytest.mark.parametrize("log", ["my.csv", "logs/my..old.csv", "./my.csv", "minari:D4RL/x/y-v2", "hopper-medium-v2@d4rl"])
def test_logs_of_the_catalogue_and_below_the_folder_are(written, log):
    assert read(written(SMALL.replace("maze2d-umaze-v1", log))).on == (log,)


@pytest.mark.parametrize("name", ["../other.toml", "{}/other.toml"])
def test_a_queue_names_suites_beside_it(written, tmp_path, name):
    (tmp_path / "inner").mkdir()
    written(SMALL, "other")
    (tmp_path / "inner" / "queue.toml").write_text(f'suites = ["{name.format(tmp_path)}"]')
    with pytest.raises(UserError, match=r"queue\.toml: suite .*: part .*(lead to another folder|is empty)"):
        queue(tmp_path / "inner" / "queue.toml")
    assert [suite.name for suite in queue(written('suites = ["other.toml"]', "queue"))] == ["other"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('agent = "bc"', 'agent = "bcc"', "unknown agent 'bcc'"),
        ("hidden = [8]", "hiden = [8]", "unknown field of bc 'hiden': did you mean hidden"),
        ('"maze2d-umaze-v1"', '"maze2d-umaze-v9"', "maze2d-umaze-v9"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is(written, old, new, message):
    with pytest.raises(UserError, match=message):
        plan(read(written(SMALL.replace(old, new))))


STRANGER = """
with open("PWNED", "w"):
    pass

def made(*args, **settings):
    return {"x": 1.0}
"""
ONLINE = 'kind = "online"\ntasks = ["%s"]\nsteps = 20_000\n[methods]\nA = { agent = "%s" }\n'
CALLED = 'kind = "study"\ncases = ["a"]\n[methods]\nA = { agent = "%s" }\n[metrics]\nx = { words = "x" }\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SMALL.replace('agent = "bc"', 'agent = "lone:made"'), "lone:made is code .*; --trust lone lets it run"),
        (CALLED % "lone:made", "lone:made is code that is not part of deadreckon; --trust lone lets it run"),
        (CALLED % "json:loads", "json:loads is code that is not part of deadreckon; --trust json lets it run"),
        (ONLINE % ("inverted-pendulum", "lone:made"), "lone:made is code .*; --trust lone lets it run"),
        (ONLINE % ("lone:made", "sac"), "task of small is lone:made, .* --trust lone lets it run"),
        (ONLINE % ("os:system?command=touch PWNED", "sac"), "system of os is no class of environments"),
    ],
)
def test_a_suite_runs_no_code_but_the_users(written, text, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lone.py").write_text(STRANGER)
    path = written(text)
    with pytest.raises(UserError, match=message):
        plan(read(path))
    for command in (["bench", "show", str(path)], ["bench", str(path), "--dry-run"]):
        assert main([*command, "--out", "out"]) == 2
        assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "PWNED").exists()


def test_a_suite_may_name_what_the_user_trusts(written, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(imports, "_TRUSTED", set())
    monkeypatch.delitem(sys.modules, "lone", raising=False)
    (tmp_path / "lone.py").write_text(STRANGER)
    path = str(written(CALLED % "lone:made"))
    assert main(["bench", "show", path, "--out", "out", "--trust", "lone"]) == 0
    assert (tmp_path / "PWNED").exists()


@pytest.mark.parametrize(
    ("agent", "steps", "message"),
    [("bc", 20_000, "method 'A': bc cannot be trained online"), ("sac", 300, "too few: .* or more")],
)
def test_an_online_suite_needs_agents_that_act_and_steps_enough(written, agent, steps, message):
    told = f'kind = "online"\ntasks = ["inverted-pendulum"]\nsteps = {steps}\n[methods]\nA = {{ agent = "{agent}" }}\n'
    with pytest.raises(UserError, match=message):
        plan(read(written(told)))


@pytest.mark.parametrize(
    ("kind", "on", "agent", "field", "message"),
    [
        ("learn", 'logs = ["maze2d-umaze-v1"]', "td3_bc", "alpha = -1.0", "TD3BC.alpha takes a finite number >= 0, got -1.0"),
        ("online", 'tasks = ["hopper"]\nsteps = 9_000', "sac", "tau = 7", "SAC.tau takes a finite number >= 0 and <= 1, got 7"),
        ("ope", 'logs = ["hopper-medium-v2"]', "fqe", "steps = -3", "FQE.steps takes a whole number >= 1, got -3"),
        ("design", 'problems = ["superconductor"]', "nemo", "steps = -3", "NEMO.steps takes a whole number >= 1, got -3"),
    ],
)
def test_a_value_that_a_field_does_not_take_is_refused_before_any_job_is_run(written, kind, on, agent, field, message):
    with pytest.raises(UserError, match=rf"method 'A' on .*: {message}"):
        plan(read(written(f'kind = "{kind}"\n{on}\n[methods]\nA = {{ agent = "{agent}", fields = {{ {field} }} }}\n')))


ACTING = """kind = "online"
tasks = ["hopper"]
steps = 20_000
[methods]
A = { agent = "sac" }
B = { agent = "sac", acting = %s }
"""


def test_a_method_may_act_otherwise_than_its_agent(written):
    own, other = plan(read(written(ACTING % "{ copies = 5, explore = 5_000, block = 25, updates_per_step = 20 }")))
    assert turns(own) == Online()
    assert turns(other) == Online(copies=5, explore=5_000, block=25, updates_per_step=20)
    assert "acting" not in own.options  # names of cells depend on it
    assert other.cells != own.cells
    same = plan(read(written(ACTING % "{ copies = 5, explore = 5_000, block = 25, updates_per_step = 20.0 }")))[1]
    assert same.cells == other.cells


@pytest.mark.parametrize(
    ("acting", "message"),
    [
        ("{ copys = 5 }", "unknown key of acting of method 'B' 'copys': did you mean copies"),
        ("{ copies = 2.5 }", "copies of acting of method 'B' must be a whole number, got 2.5"),
        ("{ block = 60 }", "block, .*, must be a multiple of copies .*, got 60, such as 56 or 64"),
    ],
)
def test_acting_that_cannot_be_is_refused(written, acting, message):
    with pytest.raises(UserError, match=message):
        plan(read(written(ACTING % acting)))


HISTORY = """logs = ["maze2d-umaze-v1"]
[methods]
A = { agent = "bc" }
B = { agent = "bc", history = %s }
"""


def test_histories_of_a_method_make_other_cells(written):
    own, other = plan(read(written(HISTORY % 4)))
    assert (other.options.get("history"), "history" in own.options) == (4, False)  # names of cells depend on it
    assert other.cells != own.cells
    assert plan(read(written(HISTORY % 1)))[1].cells == own.cells
    with pytest.raises(UserError, match="history of method 'B' must be a whole number of 1 or more, got 0"):
        read(written(HISTORY % 0))


@pytest.mark.parametrize("shift", ["-3", "true"])
def test_a_shift_of_a_method_is_checked_when_the_suite_is_read(written, shift):
    with pytest.raises(UserError, match="shift of method 'B' must be a whole number of 0 or more, got (-3|True)"):
        read(written(HISTORY.replace("history = %s", f"shift = {shift}")))
    with pytest.raises(UserError, match="about must be a text, got 5"):
        read(written("about = 5\n" + HISTORY % 1))


STUDY = """kind = "study"
cases = ["a"]
[methods]
A = { agent = "lone:made", fields = { draws = %s } }
[metrics]
%s
"""


@pytest.mark.parametrize("value", ["inf", "nan", "[1, [-inf]]", "1979-05-27", "[1979-05-27]", "{ a = 1 }", "[{ a = 1 }]"])
def test_settings_that_no_file_of_results_can_hold_are_refused(written, value):
    """Before the first cell is run."""
    plain = "must be a finite number, a text, a truth value or a list of such, got "
    with pytest.raises(UserError, match=r"small\.toml: draws of method 'A' " + plain):
        read(written(STUDY % (value, 'x = { words = "x" }')))


def test_settings_may_be_nested_lists_and_large_numbers(written):
    suite = read(written(STUDY % (f'[1, ["a", true, 1e300], {10**400}]', 'x = { words = "x" }')))
    assert suite.methods[0].fields == {"draws": [1, ["a", True, 1e300], 10**400]}


@pytest.mark.parametrize("name", ["steps", "seconds", "raw", "seed", "more"])
def test_metrics_that_are_called_as_columns_of_results_are_refused(written, name):
    """The column would be shown in the place of what the study gives."""
    with pytest.raises(UserError, match=f"metric '{name}' is called as a column of results"):
        read(written(STUDY % (1, f'{name} = {{ words = "x" }}')))
    assert read(written(STUDY % (1, 'score = { words = "x" }'))).metrics[0].column == "score"


@pytest.mark.parametrize("digits", ["-1", "13", "true"])
def test_digits_of_metrics_are_few(written, digits):
    with pytest.raises(UserError, match="digits of metric 'x' must be a whole number from 0 to 12, got"):
        read(written(STUDY % (1, f'x = {{ words = "x", digits = {digits} }}')))
    assert read(written(STUDY % (1, 'x = { words = "x", digits = 12 }'))).metrics[0].digits == 12


def test_an_unknown_suite_names_the_nearest():
    with pytest.raises(UserError, match="did you mean quick"):
        read("quik")


BESIDE = """kind = "online"
tasks = ["maze2d-umaze"]
data = { maze2d-umaze = "maze2d-umaze-v1" }
rows = 600
steps = 400
offline = 30
evaluations = 2
[methods]
Start = { agent = "td3_bc", log = "first", acting = { copies = 4, block = 40 } }
Replay = { agent = "rlpd", preset = true, log = "beside", acting = { copies = 1, explore = 40, block = 1 } }
Nothing = { agent = "sac", acting = { explore = 40, block = 40 } }

[full]
offline = 90
steps = 800
"""


def test_a_method_may_go_on_from_the_log_of_its_task_or_have_it_in_its_replay(written):
    start, replay, nothing = plan(read(written(BESIDE)))
    assert start.options["log"] == {"name": "maze2d-umaze-v1", "use": "first", "offline": 30}
    assert replay.options["log"] == {"name": "maze2d-umaze-v1", "use": "beside"}
    assert "log" not in nothing.options  # names of cells depend on it
    assert (start.data, start.rows) == ("maze2d-umaze, maze2d-umaze-v1@dr1-600-steps", 600)
    assert (nothing.data, nothing.rows) == ("maze2d-umaze", None)
    assert (turns(start).explore, turns(replay).updates_per_step, turns(nothing).explore) == (0, 20.0, 40)
    assert start.revisions["acting"] == replay.revisions["acting"] != nothing.revisions["acting"]
    assert plan(read(written(BESIDE), full=True))[0].options["log"]["offline"] == 90


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('log = "first"', 'log = "last"', "log of method 'Start' must be one of first, beside, got 'last'"),
        ('data = { maze2d-umaze = "maze2d-umaze-v1" }\n', "", "data must name a log of each of .* for the log of method"),
        ('"maze2d-umaze-v1"', "3", "data must name a log of each of maze2d-umaze"),
        ("offline = 30", "offline = 0", "offline must be a whole number of 1 or more, got 0"),
        ('kind = "online"\ntasks', 'kind = "learn"\nlogs', "unknown key of a suite of kind learn 'data'"),
    ],
)
def test_a_suite_that_says_too_little_of_logs_is_refused(written, old, new, message):
    with pytest.raises(UserError, match=message):
        read(written(BESIDE.replace(old, new)))


def test_an_agent_that_cannot_go_on_is_refused(written):
    with pytest.raises(UserError, match="method 'Replay': ppo cannot be trained online"):
        plan(read(written(BESIDE.replace('"rlpd", preset = true', '"ppo"'))))


DESIGNS = """
kind = "design"
seeds = 1
budget = "cpu"
problems = ["gfp", "branin"]
files = { gfp = "0123456789abcdef" }
[methods]
best = { agent = "best" }
"""


def test_cells_of_a_declared_file_are_the_same_where_the_file_is_not(written, home, tmp_path, monkeypatch):
    """And nothing is made from another one."""
    gfp, branin = plan(read(written(DESIGNS)))
    assert (gfp.data, branin.data) == ("gfp 0123456789abcdef", "branin")
    path = home / "designs" / "avgfp.tsv"
    path.parent.mkdir(parents=True)
    path.write_text("variant\tscore\n")
    assert plan(read(written(DESIGNS)))[0].cells == gfp.cells
    monkeypatch.setattr("deadreckon.mbo.problem", lambda name: None)
    with pytest.raises(UserError, match=r"^avgfp.tsv is not the file that was planned with: gfp 0123456789abcdef there, gfp "):
        perform(Program((gfp,)), tmp_path / "run")
    # A plan that was made without the file names none: it goes on, here to the problem, which is none.
    with pytest.raises(AttributeError, match="visible"):
        perform(Program((dataclasses.replace(gfp, data="gfp"),)), tmp_path / "run")


@pytest.mark.parametrize(("old", "new", "message"), [
    ('gfp = "0123456789abcdef"', 'tfbind8 = "0123456789abcdef"', "files must give digests of files of some of gfp, branin"),
    ('"0123456789abcdef"', '"123"', "the digest of the file of gfp must be 16 hexadecimal digits, got '123'"),
    ('"0123456789abcdef"', "3", "must be 16 hexadecimal digits, got 3"),
    ('{ gfp = "0123456789abcdef" }', '"x"', "files must give digests of files of some of gfp, branin, got 'x'"),
])  # fmt: skip
def test_digests_of_files_that_are_none(written, old, new, message):
    with pytest.raises(UserError, match=message):
        read(written(DESIGNS.replace(old, new)))
