"""Text files that try to be misread, and what is made of them."""

import datetime

DAY = datetime.datetime


def moment(*parts):
    return DAY(*parts)


SEMICOLONS, TABS = "columns are separated by semicolons (--separator)", "columns are separated by tabs (--separator)"
ASK_DMY = "are read as day.month.year (--dates month-first)"
# name: (content, options, {column: values}, what is told, in order)
READ = {
    "plain": ("a,b\n1,x\n2,y\n", {}, {"a": [1, 2], "b": ["x", "y"]}, []),
    "plain with a byte order mark": (
        "a,b\n1,x\n2,y\n".encode("utf-8-sig"), {}, {"a": [1, 2], "b": ["x", "y"]}, [],
    ),
    "Excel, German": (
        "Datum;Ventil;Leistung;in Betrieb\r\n01.02.2024;0,5;1.234,56;ja\r\n29.02.2024;0,75;999,5;nein\r\n", {},
        {"Datum": [moment(2024, 2, 1), moment(2024, 2, 29)], "Ventil": [0.5, 0.75], "Leistung": [1234.56, 999.5],
         "in Betrieb": [True, False]},
        [SEMICOLONS, "decimal commas: '0,5' is read as 0.5 (--decimal)",
         "thousands are separated by points: '1.234,56' is read as 1234.56 (--thousands)",
         "read as true and false: in Betrieb (ja/nein)", "taken out of the numbers in Leistung",
         f"dates such as '01.02.2024' {ASK_DMY}: column Datum"],
    ),
    "Excel, German, saved in Windows-1252": (
        "Größe;Straße\r\n1,5;Süd\r\n2,5;Öst\r\n".encode("cp1252"), {},
        {"Größe": [1.5, 2.5], "Straße": ["Süd", "Öst"]},
        ["not UTF-8, and is read as Windows-1252 (Latin-1), such as 'Größe' (--encoding)", SEMICOLONS, "decimal commas"],
    ),
    "a euro sign tells Windows-1252 from Latin-1": (
        "a,b\n1,\x80\n".encode("latin-1"), {}, {"a": [1], "b": ["€"]}, ["Windows-1252"],
    ),
    "bytes that Windows-1252 does not have": (
        "a,b\n1,\x81é\n".encode("latin-1"), {}, {"a": [1], "b": ["\x81é"]}, ["not UTF-8"],
    ),
    "LibreOffice, UTF-16 with tabs": (
        "zeit\tmaß\n2024-01-01 10:00\t1,5\n2024-01-02 11:30\t2,25\n".encode("utf-16"), {},
        {"zeit": [moment(2024, 1, 1, 10), moment(2024, 1, 2, 11, 30)], "maß": [1.5, 2.25]},
        ["encoded in UTF-16 (--encoding)", TABS, "decimal commas"],
    ),
    "UTF-16, big end first, with its mark": (
        b"\xfe\xff" + "a\tb\n1\tü\n".encode("utf-16-be"), {}, {"a": [1], "b": ["ü"]}, ["UTF-16", TABS],
    ),
    "UTF-16 without a mark": ("a,b\n1,ü\n".encode("utf-16-le"), {}, {"a": [1], "b": ["ü"]}, ["UTF-16"]),
    "UTF-16, big end first, without a mark": ("a,b\n1,ü\n".encode("utf-16-be"), {}, {"a": [1], "b": ["ü"]}, ["UTF-16"]),
    "pandas, sep=';', decimal=','": (
        ";x;y;arm\n0;0,1234;-1,5e-05;a\n1;2,0;3,25;b\n", {},
        {"": [0, 1], "x": [0.1234, 2.0], "y": [-1.5e-05, 3.25], "arm": ["a", "b"]}, [SEMICOLONS, "decimal commas: '0,1234'"],
    ),
    "R, write.csv2": (
        '"";"speed";"site"\n"1";4,5;"a"\n"2";NA;NA\n"3";7;"b"\n', {},
        {"": [1, 2, 3], "speed": [4.5, None, 7.0], "site": ["a", "NA", "b"]},
        [SEMICOLONS, "decimal commas: '4,5'", "column site: 'NA' is a text like others in 1 row; empty such cells"],
    ),
    "Google Sheets, English": (
        'when,revenue,ok\n1/13/2024,"1,234.50",TRUE\n2/1/2024,12.00,FALSE\n', {},
        {"when": [moment(2024, 1, 13), moment(2024, 2, 1)], "revenue": [1234.5, 12.0], "ok": [True, False]},
        ["thousands are separated by commas: '1,234.50' is read as 1234.50 (--thousands)", "numbers in revenue",
         "dates such as '1/13/2024' are read as month/day/year (--dates day-first): column when"],
    ),
    "Google Sheets, German, with commas between columns": (
        'a,b\n"1,5",x\n"2,25",y\n', {}, {"a": [1.5, 2.25], "b": ["x", "y"]}, ["decimal commas: '1,5' is read as 1.5"],
    ),
    "SAP, with thousands, signs behind and a separator at the end": (
        "Werk;Menge;Betrag;\n1000;1.234;1.234,56-;\n1010;12;7,00;\n", {},
        {"Werk": [1000, 1010], "Menge": [1234, 12], "Betrag": [-1234.56, 7.0]},
        [SEMICOLONS, "decimal commas: '1.234,56-' is read as -1234.56", "separated by points: '1.234,56-'",
         "column Betrag: a minus sign behind a number is one before it ('1.234,56-')", "numbers in Menge, Betrag"],
    ),
    "Excel's line of the separator": ("sep=;\r\na;b\r\n1;2\r\n", {}, {"a": [1], "b": [2]}, [SEMICOLONS]),
    "a line that names an odd separator": ("sep=%\na%b\n1%2\n", {}, {"a": [1], "b": [2]}, ["separated by '%'"]),
    "codes of digits": (
        "zip,id,x\n01067,12345678901234567890,0\n80331,5,0.5\n,,1\n", {},
        {"zip": [1067, 80331, None], "id": [1.2345678901234567e19, 5.0, None], "x": [0.0, 0.5, 1.0]},
        ["column id: '12345678901234567890' is rounded", "column zip: '01067' is read as the number 1067 (row 0)"],
    ),
    "many columns of texts that look like numbers": (
        ",".join(f"c{index}" for index in range(12)) + "\n" + ",".join(["5%"] * 12) + "\n", {},
        {f"c{index}": ["5%"] for index in range(12)},
        ["column c0 is read as texts, though '5%'"] + ["column c"] * 9 + ["2 more lines"],
    ),
    "Excel's line of the separator, in UTF-16": (
        "sep=\t\r\na\tb\r\n1\t2\r\n".encode("utf-16"), {}, {"a": [1], "b": [2]}, ["UTF-16", TABS],
    ),
    "Swiss": (
        "a;b\n12'345.60;x\n1'000.00;y\n", {}, {"a": [12345.6, 1000.0], "b": ["x", "y"]},
        [SEMICOLONS, "thousands are separated by apostrophes: \"12'345.60\" is read as 12345.60", "numbers in a"],
    ),
    "French": (
        "a;b\n1\u202f234,5;oui\n12\u00a0000,0;non\n", {}, {"a": [1234.5, 12000.0], "b": [True, False]},
        [SEMICOLONS, "decimal commas", "thousands are separated by spaces", "b (oui/non)", "numbers in a"],
    ),
    "Indian English": (
        'a,b\n"1,234,567",x\n-12,y\n', {}, {"a": [1234567, -12], "b": ["x", "y"]}, ["by commas", "numbers in a"],
    ),
    "bars": ("a|b\n1|2,5\n", {}, {"a": [1], "b": [2.5]}, ["separated by vertical bars", "decimal commas"]),
    "single quotes": ("'a';'b'\n'x;y';1\n'z';2\n", {}, {"a": ["x;y", "z"], "b": [1, 2]}, [SEMICOLONS, "single quotes"]),
    "a title above": (
        "Report of May, draft\n\na;b\n1;2\n3;4\n", {}, {"a": [1, 3], "b": [2, 4]},
        [SEMICOLONS, "lines above the line of names are left out: 2, such as 'Report of May, draft'"],
    ),
    "comments above": (
        "# site 7\n# unit: kW\na,b\n1,2\n3,4\n", {}, {"a": [1, 3], "b": [2, 4]}, ["are left out: 2, such as '# site 7'"],
    ),
    "a name with a number sign is no comment": ("#a,b\n1,2\n3,4\n", {}, {"#a": [1, 3], "b": [2, 4]}, []),
    "names of numbers, as table libraries count": (",0,1\n0,5,6\n1,7,8\n", {}, {"": [0, 1], "0": [5, 7], "1": [6, 8]}, []),
    "blanks around names": (
        " a , b\u00a0,\"c\nd\"\n1,2,3\n", {}, {"a": [1], "b": [2], "c d": [3]}, ["blanks around or within names"],
    ),
    "old line ends": ("a,b\r1,2\r3,4\r", {}, {"a": [1, 3], "b": [2, 4]}, []),
    "line ends in quotes": (
        'a,b,c\n1,"x\ny",3\n2,z,4\n', {}, {"a": [1, 2], "b": ["x\ny", "z"], "c": [3, 4]}, [],
    ),
    "a line end in quotes at the very end": ('a,b\n1,x\n2,"y\n"\n', {}, {"a": [1, 2], "b": ["x", "y\n"]}, []),
    "rows of empty cells at the end": ("a;b\n1;x\n;\n;\n", {}, {"a": [1], "b": ["x"]}, [SEMICOLONS, "are left out: 2"]),
    "words for missing": (
        "a,b,c,d\nNA,n/a,x,2024-01-01\nNaN,null,,\n1,2.5,y,NA\nNone,N/A,x,2024-01-02\n", {},
        {"a": [None, None, 1, None], "b": [None, None, 2.5, None], "c": ["x", None, "y", "x"],
         "d": [datetime.date(2024, 1, 1), None, None, datetime.date(2024, 1, 2)]}, [],
    ),
    "dashes": (
        "a,b,c\n1,-,x\n-,2.5,-\n3,4,y\n", {}, {"a": [1, None, 3], "b": [None, 2.5, 4.0], "c": ["x", "-", "y"]},
        ["column a: '-' is a missing number in 1 row", "column b: '-' is a missing number",
        "column c: '-' is a text like others"],
    ),
    "signs at both ends, and an exponent alone": (
        "a;b\n-1-;e5\n2-;7e5\n", {}, {"a": ["-1-", "2-"], "b": ["e5", "7e5"]},
        [SEMICOLONS, "column a is read as texts", "column b is read as texts: 1 of 2 cells"],
    ),
    "flags": (
        "a,b,c,d,e,f,g\nyes,J,n,t,on,True,no\nNo,N,Y,F,off,false,no\n,J,,T,on,,no\n", {},
        {"a": [True, False, None], "b": [True, False, True], "c": [False, True, None], "d": [True, False, True],
         "e": [True, False, True], "f": [True, False, None], "g": [False, False, False]},
        ["read as true and false: a (yes/no), b (j/n), c (y/n), d (t/f), e (on/off), g (yes/no)"],
    ),
    "no flags": (
        "a,b,c,d\nyes,y,m,on\nno,y,f,on\nmaybe,,m,on\n", {},
        {"a": ["yes", "no", "maybe"], "b": ["y", "y", None], "c": ["m", "f", "m"], "d": ["on", "on", "on"]}, [],
    ),
    "dates of all forms": (
        "iso,zone,dot,slash,us,year,dash\n"
        "2024-01-02T10:00:00,2024-01-02T10:00:00Z,2.1.2024 09:05,13/01/2024,1/13/2024 2:30:05 PM,2024/01/02,02-01-2024\n"
        "2024-12-31 23:59:59,2024-01-02 12:00:00+02:00,"
        "31.12.2024 23:59:01,01/02/2024,12/1/2024 12:00:00 AM,2024/12/31,31-12-2024\n",
        {},
        {"iso": [moment(2024, 1, 2, 10), moment(2024, 12, 31, 23, 59, 59)],
         "zone": [DAY(2024, 1, 2, 10, tzinfo=datetime.UTC), DAY(2024, 1, 2, 10, tzinfo=datetime.UTC)],
         "dot": [moment(2024, 1, 2, 9, 5), moment(2024, 12, 31, 23, 59, 1)], "slash": [moment(2024, 1, 13), moment(2024, 2, 1)],
         "us": [moment(2024, 1, 13, 14, 30, 5), moment(2024, 12, 1)], "year": [moment(2024, 1, 2), moment(2024, 12, 31)],
         "dash": [moment(2024, 1, 2), moment(2024, 12, 31)]},
        ["'2024/01/02' are read as year/month/day: column year", f"'2.1.2024 09:05' {ASK_DMY}: column dot",
         "'13/01/2024' are read as day/month/year (--dates month-first): column slash",
         "'1/13/2024 2:30:05 PM' are read as month/day/year (--dates day-first): column us",
         "'02-01-2024' are read as day-month-year (--dates month-first): column dash"],
    ),
    "fractions of seconds": (
        "d,x\n01.02.2024 10:00:00.5,1\n02.02.2024 10:00,2\n", {},
        {"d": [moment(2024, 2, 1, 10, 0, 0, 500000), moment(2024, 2, 2, 10)], "x": [1, 2]}, [ASK_DMY],
    ),
    "dates that no cell tells, beside points": (
        "d,x\n03/04/2024,1.5\n05/06/2024,2\n", {}, {"d": [moment(2024, 3, 4), moment(2024, 5, 6)], "x": [1.5, 2]},
        ["read as month/day/year, and no cell shows whether that is right (--dates day-first): column d"],
    ),
    "dates that no cell tells, beside semicolons": (
        "d;x\n03/04/2024;1\n05/06/2024;2\n", {}, {"d": [moment(2024, 4, 3), moment(2024, 6, 5)], "x": [1, 2]},
        [SEMICOLONS, "read as day/month/year, and no cell shows whether that is right (--dates month-first): column d"],
    ),
    "dates that another column tells": (
        "d,e\n03/04/2024,01/02/2024\n25/06/2024,03/04/2024\n", {},
        {"d": [moment(2024, 4, 3), moment(2024, 6, 25)], "e": [moment(2024, 2, 1), moment(2024, 4, 3)]},
        ["read as day/month/year (--dates month-first): columns d, e"],
    ),
    "a date that there is not": (
        "d,x\n01.02.2024,1\n31.02.2024,2\n05.03.2024,3\n", {}, {"d": ["01.02.2024", "31.02.2024", "05.03.2024"], "x": [1, 2,
        3]},
        ["column d has '31.02.2024' in row 1, which is no date read as day.month.year", "column d is read as texts, though"],
    ),
    "dates of two orders in one column": (
        "d,x\n13/02/2024,1\n02/13/2024,2\n", {}, {"d": ["13/02/2024", "02/13/2024"], "x": [1, 2]},
        ["column d has '13/02/2024' in row 0, which is no date read as month/day/year", "read as texts, though '13/02/2024'"],
    ),
    "one comma and three digits, beside semicolons": (
        "a;b\n1,234;x\n5,678;y\n", {}, {"a": [1.234, 5.678], "b": ["x", "y"]},
        [SEMICOLONS, "'1,234' is read as 1.234, not as 1234: beside semicolons a comma is taken for decimals"],
    ),
    "the same, and a point elsewhere": (
        "a;b\n1,234;0.5\n5,678;1.5\n", {}, {"a": [1234, 5678], "b": [0.5, 1.5]},
        [SEMICOLONS, "thousands are separated by commas: '1,234' is read as 1234 (--thousands)", "numbers in a"],
    ),
    "the same, beside tabs": (
        "a\tb\n1,234\tx\n5\ty\n", {}, {"a": [1234, 5], "b": ["x", "y"]},
        [TABS, "'1,234' is read as 1234, not as 1.234, and no other cell tells (--decimal comma)", "numbers in a"],
    ),
    "one point and three digits, beside semicolons": (
        "a;b\n1.234;x\n5.678;y\n", {}, {"a": [1.234, 5.678], "b": ["x", "y"]},
        [SEMICOLONS, "'1.234' is read as 1.234, not as 1234, and no other cell tells (--thousands point)"],
    ),
    "the same, and a comma elsewhere": (
        "a;b\n1.234;0,5\n5.678;2,5\n", {}, {"a": [1234, 5678], "b": [0.5, 2.5]},
        [SEMICOLONS, "decimal commas: '0,5'", "by points: '1.234' is read as 1234 (--thousands)", "numbers in a"],
    ),
    "the same, and decimals that are no thousands in the column": (
        "a;b\n1.234;0,5\n0.678;2,5\n", {}, {"a": ["1.234", "0.678"], "b": [0.5, 2.5]},
        [SEMICOLONS, "decimal commas: '0,5'", "by points: '1.234'", "but '0.678' has another mark (--decimal)",
         "column a is read as texts, though '1.234' looks like a number"],
    ),
    "three decimals in a plain file": ("a,b\n1.234,x\n5.678,y\n", {}, {"a": [1.234, 5.678], "b": ["x", "y"]}, []),
    "points for decimals in some columns and thousands in one": (
        "a;b;c\n0.5;0.7;1.234.567\n", {}, {"a": [0.5], "b": [0.7], "c": ["1.234.567"]},
        [SEMICOLONS, "column c is read as texts, though '1.234.567' looks like a number"],
    ),
    "numbers with and without marks": (
        'a,b\n"1,234.5",x\n1234.5,y\n', {}, {"a": ["1,234.5", "1234.5"], "b": ["x", "y"]},
        ["thousands are separated by commas", "column a is read as texts, though '1,234.5' looks like a number"],
    ),
    "shares": ("a,b\n12.5%,x\n3%,y\n", {}, {"a": ["12.5%", "3%"], "b": ["x", "y"]}, ["texts, though '12.5%' looks like"]),
    "an odd cell behind the first block": (
        "a,b\n" + "1,x\n" * 50_000 + "3.5,n/a\nn/a,y\n", {"tail": 3},
        {"a": [1.0, 3.5, None], "b": ["x", "n/a", "y"]}, ["column b: 'n/a' is a text like others in 1 row"],
    ),
    "an odd text far behind": (
        "a,b\n" + "".join(f"{row},x\n" for row in range(90_000)) + "oops,y\n", {"tail": 2}, {"a": ["89999", "oops"],
        "b": ["x", "y"]},
        ["column a is read as texts: 90000 of 90001 cells look like numbers or dates, row 90000 has 'oops'"],
    ),
    "Latin-1 behind a head of ASCII": (
        b"a,b\n" + b"1,x\n" * 100_000 + b"2,\xe4\n", {"tail": 2}, {"a": [1, 2], "b": ["x", "ä"]},
        ["from row 100000 on the text is not UTF-8, and is read as Windows-1252 (Latin-1), such as 'ä' (--encoding)"],
    ),
    "quotes that swallow rows": (
        'a,b\n1,x\n2,"y\n3,z\n4,"w\n5,v\n', {}, {"a": [1, 2, 5], "b": ["x", "y\n3,z\n4,w", "v"]},
        ["column b: a text in quotes holds lines that look like rows, such as '3,z'; is a quote missing"],
    ),
    "two separators that fit": (
        "a,b;c\n1,2;3\n4,5;6\n", {}, {"a": [1, 4], "b;c": ["2;3", "5;6"]},
        ["separated by commas, but semicolons would split every line alike (--separator)"],
    ),
    # ---- told what they are
    "a separator": ("a,b;c\n1,2;3\n", {"separator": ";"}, {"a,b": [1.2], "c": [3]}, ["decimal commas: '1,2'"]),
    "a separator by its name": ("a b\n1 2\n", {"separator": "space"}, {"a": [1], "b": [2]}, []),
    "a decimal point": (
        "a;b\n1,234;x\n", {"decimal": "."}, {"a": [1234], "b": ["x"]}, [SEMICOLONS, "by commas", "numbers in a"],
    ),
    "thousands": (
        "a;b\n1,234;x\n", {"thousands": "comma"}, {"a": [1234], "b": ["x"]}, [SEMICOLONS, "numbers in a"],
    ),
    "no thousands": (
        "a;b\n1.234;0,5\n", {"thousands": "none"}, {"a": ["1.234"], "b": [0.5]}, [SEMICOLONS, "decimal commas",
        "read as texts"],
    ),
    "an encoding": ("a,b\n1,\xe4\n".encode("cp850"), {"encoding": "cp850"}, {"a": [1], "b": ["ä"]}, []),
    "the day first": ("d,x\n03/04/2024,1\n", {"dates": "day-first"}, {"d": [moment(2024, 4, 3)], "x": [1]}, []),
    "the month first": ("d;x\n03.04.2024;1\n", {"dates": "month-first"}, {"d": [moment(2024, 3, 4)], "x": [1]}, [SEMICOLONS]),
    "the day first, where it is not": (
        "d,x\n03/04/2024,1\n03/14/2024,1\n", {"dates": "day-first"}, {"d": ["03/04/2024", "03/14/2024"], "x": [1, 1]},
        ["column d has '03/14/2024' in row 1, which is no date read as day/month/year (--dates)", "read as texts"],
    ),
    "no dates but ISO's": (
        "d,x\n03/04/2024,2024-01-02\n", {"dates": "iso"}, {"d": ["03/04/2024"], "x": [datetime.date(2024, 1, 2)]}, ["as texts"],
    ),
}  # fmt: skip
