"""Ctrl-C while a class is being created: Python 3.11 wraps it in a RuntimeError."""

from errpipe.cli import _verbs, app


def test_ctrl_c_within_set_name_is_an_interruption(monkeypatch, capsys) -> None:
    class Field:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    def verb(arguments):
        type("Document", (), {"field": Field()})

    monkeypatch.setattr(_verbs, "invoke", verb)
    assert app.main(["doctor"]) == 130
    assert capsys.readouterr().err == "interrupted; the same command continues from here\n"
