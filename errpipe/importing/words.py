"""Names of columns, directions and signs: English, German, French, Italian, Spanish, Japanese, Chinese.

Deviations, corrections and targets also in Portuguese, Dutch, Polish, Czech, Swedish, Danish, Turkish, Russian, Korean.

Texts are compared in the form of `plain`: lower case, umlauts transcribed, no accents, blanks for underscores.
"""

from __future__ import annotations

import re
import unicodedata

CORRECTION = (  # minus the deviation
    r"\b(corrections?|\w*korrektur(en|werte?|tabelle|daten)?|corr|comp(ensation)?s?|\w*kompensation(s(werte?|tabelle|daten))?|correzion[ei]"
    r"|correccion(es)?|correctif|compensazion[ei]|compensacion(es)?|compensacao|correc(?:ao|oes)|correctie|compensatie|korekc\w*|korekt\w*|popraw\w*"
    r"|kompensac\w*|kompenzac\w*|korrigering\w*|kompensering\w*|duezeltme\w*|telafi\w*"
    r"|to apply|adjustments?|nachstell\w*|ausgleich(swerte?)?|verrechnung(swerte?)?)\b"
    r"|補正|补偿|修正|коррекц\w*|компенсац\w*|поправ\w*|보정"
)

# For readings referred to 20 degC, or to the air of a laser: it does not concern their sign.
_TO_20_DEGREES = re.compile(
    r"\(?\b(temp(erature?|eratur)?|thermal(ly)?|thermisch|wavelength|material|air)[ .-]*"
    r"(comp(ensated)?|compense\w*|corr(ected)?|kompensiert|korrigiert)\b\.?\)?"
)

# In controllers: command minus actual position (LinuxCNC: pos-cmd less pos-fb; TwinCAT: SetPos less ActPos;
# a control deviation is w - x, DIN IEC 60050-351).
FOLLOWING = (
    r"(schlepp(fehler|abstand)|follow(ing)? ?(err|dist)|lag ?(err|dist)|^[xyzabcuvw]\d? lag\b|pos(ition)? ?(diff|lag)"
    r"|\bf[ -]?error|regel(abweichung|differenz)|control ?(deviation|error)|restweg|distance to go"
    r"|remaining ?(distance|way))"
)

BEFORE_A_STATE = (
    r"(?:after|before|with|without|nach|vor|mit|ohne|apres|avant|sans|avec"
    r"|(?:dopo|prima|con|senza|despues|antes|sin|depois|apos|com|sem|na|met|zonder|voor|po|pred|przed|bez|efter|etter"
    r"|foere?|før|med|utan|uten|uden|после|до|без)(?= (?:[^\W\d]+ ){0,2}(?:[ck]o[mr]|popraw|ко[мр]|поправ)))"
)
_STATE_OF_A_COMPENSATION = (
    rf"\b({BEFORE_A_STATE}|on|off|ein|aus|oencesi|sonras[iı])\b|(?:補正|补偿|修正|보정) ?(?:[前後后전후]|なし|あり)"
)

SIMULATED = (
    r"\b(sim|simul\w*|modell?|modele|model[lo]o|predict(ed|ion)|vorhersage|prognose|fe[am]|(digital ?)?twin|zwilling)\b"
    r"|仿真"
)
FORCES = r"(force|kraft|torque|drehmoment|moment)"
# Of a tool point: a deviation, unless it has the range of a travel.
DISPLACEMENT = (
    r"(displacement|\bdisp\b|\bgrowth|wachstum|laengung|verlagerung|verschiebung|\bdrift\b|\bderiv[ae]\b|spostamento|deplacement|desplazamiento"
    r"|変位|位移)"
)

DISTANCE = r"^dist(ance|anz|anza|ancia)?$"  # a position where no other column is one

# Header of labels that can form hold-out groups -> what they label (`of` in the manifest).
GROUPS = {
    "season": r"season|saison|jahreszeit",
    "month": r"month|monat|mois",
    "day": r"day|tag|jour",
    "shift": r"shift|schicht",
    "duty_cycle": r"duty ?cycle|lastzyklus|lastkollektiv",
    "machine": r"machine|maschine|macchina|maquina|serial|serien(nummer|nr)|机床|機械",
    "session": r"session|sitzung|campaign|kampagne",
    "tool": r"tool|werkzeug|outil|utensile|herramienta",
}
GROUP = rf"^({'|'.join(GROUPS.values())})[ -]?(no\.?|nr\.?|id|name|number|nummer|#)?$"

# Patterns of headers -> their role. The first match applies.
WORDS: tuple[tuple[str, str], ...] = (
    (SIMULATED, "simulated"),
    (
        r"\b(limite?|mpe|grenz(e|wert)|[ou]?tol|toleran(ce|z)|[lu]sl|(?:un|in)cert\w*|\w*unsicherheit)\b|\bu ?\(k",
        "ignore",
    ),
    (r"^(freq(uency|uenz|uence)?|hz)\b", "ignore"),
    (
        # Not `Deviation without backlash`, nor `Error (backlash comp. off)`.
        r"^(?!.*\b(?:with(?:out)?|w/o|incl\w*|excl\w*|mit|ohne|avec|sans|con|senza|sin|comp\w*|kompens\w*|korr\w*)\b)"
        r".*\b(?:backlash|lost motion|umkehrspann?e|umkehrspiel|jeu a l.inversion|gioco|juego|bosluk)\b"
        r"|反向间隙|反向偏差",
        "ignore",
    ),
    (GROUP, "group"),
    (
        r"(zeit|time|datum|date|stamp|\bunix\b|(?<!mess)uhr|horodat|\butc\b|\bm?jd\b|julian|heure|\bora\b|\bfecha\b|\bhora\b|elapsed|duration|\bdauer\b|時刻|時間|时间|日時)",
        "time",
    ),
    (
        r"^(t|ts|sec|sek|min|h|x value|seconds|sekunden|secondes|secondi|segundos|minutes|minuten|minuti|minutos|hours"
        r"|stunden|heures|horas)$",
        "time",
    ),
    (
        r"(temp|^t[ .]|[ ]t$|tmp|thermo|^pt100|°c|degc|温度)|^tc? ?\d{1,2}$"
        r"|^t?(ambient|room|raum|umgebung|hall|halle|shop)( ?air| ?luft)?$|^t(amb|air|luft|spindle|spindel|bed|bett)$",
        "temperature",
    ),
    (
        r"(dir(ection)?|richtung|approach|anfahr|sense?|sens|sinn|sentido|direzione|verso|direccion|direcao|kierunek|irany|smer"
        r"|riktning|richting|suunta|方向|방향|направлени\w*|напрям\w*|κατευθυνση)\b",
        "direction",
    ),
    (
        r"\b(run|lauf|durchlauf|cycle|[zc]yklus|cyclus|ciclo|korning|durchgang|messreihe|pass(?:age)?|serie|trial|essai|passe|prova|ensayo|pasada)\b|回数|次数|회차|^цикл|^проход|^прохід|^ciclu\b|^ajo\b|^κυκλος",
        "run",
    ),
    (r"(count|inkrement|\binc\b|pulse|impuls|raw ?enc|\bdigits?\b|\bdiv(isions?)?\b|teilstrich|\blsb\b)", "counts"),
    (r"(cut(ting)? ?(length|distance|path)|length (of )?cut|schnitt(laenge|weg))", "cut_length"),
    (r"(depth ?of ?cut|cut(ting)? ?depth|schnitttiefe|zustellung)", "depth_of_cut"),
    (r"(overhang|stick ?out|auskrag|auslade?laenge|ausspannlaenge)", "overhang"),
    (r"(workpiece|werkstueck|part|pallet|palette) ?(mass|weight|load|masse|gewicht)|^payload$", "load"),
    (
        r"^(coolant|kuehlmittel|kuehlung|kss|emulsion|refrigerant)( ?(on|an|ein|state|status|flow|active|aktiv))?"
        r"( ?[\[(]l/min[\])])?$",
        "coolant",
    ),
    (r"(torque|drehmoment|moment)", "torque"),
    (r"\b(current|aktuelle?) ?pos(ition)?\b|^[xyzabcuvw]\d? pv$|process ?value|\$va im\b", "actual"),
    (r"^[xyzabcuvw]\d? (set|sp)$|\$aa i[bmw]\b", "command"),  # of a SINUMERIK: set points of the axis
    (
        r"(current(?! ?(program|feed(?!b)|line|block|seq|tool|vel|speed|temp|time|stat|mode|step|cycle|no\b|num))"
        r"|strom|\biq\b|\bi q\b|ampere)",
        "current",
    ),
    (r"(force|kraft)|^f ?[xyz]$", "force"),
    (r"(spindle ?speed|drehzahl|rpm|\bs act\b(?! [xyzabc]))", "spindle_speed"),
    (r"(feed ?rate|vorschub|\bfeed\b)", "feed"),
    (r"(press|druck|baro)", "pressure"),
    (r"(humid|feucht)", "humidity"),
    (
        r"(deviation|abweich|\babw|error(?! ?(code|id|stat|flag|n[ou]|bit|m|word|text))|err\b"
        r"|fehler(?! ?(code|nr|nummer|text))|\bdev\b|residual|lage ?abw|\becart|erreur|scostamento|desviacion"
        r"|errore|\berros?\b|deviazion|desvio|afwijking|\bfout|odchyl|odchyłk|\bbład|\bchyb|avvik|\belteres|afvigelse|\bfejl|\bsapma"
        r"|\bhata|\babater[ei]|poikkeama|αποκλιση|偏差|誤差|误差|отклонени|погрешност|ошибк|відхиленн|похибк|오차|편차)",
        "error",
    ),
    (DISPLACEMENT, "error"),
    (FOLLOWING, "error"),
    (CORRECTION, "error"),
    (r"(straightness|geradheit)", "error"),
    (r"(velocity|geschw|\bvel\b|speed)", "velocity"),
    (r"(accel|beschl)", "acceleration"),
    (
        r"(target|soll|ziel|nominal|\bdesign\b|\bnom\b|nenn(wert|mass|laenge)|calibrated( (value|length|position))?$"
        r"|kalibrier(wert|ter wert|te laenge|t)$"
        r"|command|\bcmd|\bnoml\b|set ?(point|pos)|\bpos ?set\b|demand|ref(erence)?\b|consign[ea]"
        r"|theorique|cible|teoric|objetivo|\balvo\b|doelpos|malpos|zadan|cilov|hedef|gewenst|boervaerd|borvard|celpoz|\btinta\b|kohde|tavoite|στοχος|目標|目标|指令|задан|целев|цільов|목표)",
        "command",
    ),
    (
        r"(actual|\bas ?-?built"
        r"|\b[xyzabcuvw]?\d?ist\b|ist(wert|mass)|\bprobed\b|\bangetastet|\bfbk\b|measured|\bmeas\b|gemessen|messwert|reading|anzeige|feedback|\bfb\b|\bactl?\b|encoder"
        r"|laser|dial|indicator|uhr|\bmesure|releve|misurat|\bmedid|display|read ?out|\bdro\b|\bgemeten|\bwerkelijk"
        r"|aervaerd|arvard|uppmaett|zmierzon|rzeczywist|skutecn|namer|oelcuelen|olculen|\bgercek|\bmert\b|tenyleg|\breale?\b|\breelle\b|\bmisura\b|lectura|leitura|lettura|実測|实测|測定値|测量|测定|实际"
        r"|измерен|фактич|действит|측정|실제)",
        "actual",
    ),
    (
        rf"(position|\bpos|{DISTANCE}|^[xyzabcuvw]\d?$|^[pxyz] ?i$|weg"
        r"|^[xyz] ?(axis|achse|-achse)|\b(angle|(dreh|schwenk)?winkel)\b"
        r"|posizione|posicion|\bquota\b|\bcotas?\b|\bcotes?\b|\bpozyc|\bpozic|\bposicao|位置|позици|положени|координат)",
        "position",
    ),
)

# Words of a cell or header -> the side from which a target was approached.
UP = re.compile(
    r"\+1?|1|↑|→|>+|up?|auf(waerts)?|f|fw|fwd|forwards?|v|vor(w|waerts)?|h|hin(weg|fahrt)?|p|pos|positive?|plus|rising|asc(ending)?"
    r"|increasing|steigend|below|unten|aller|avance|montee|andata|avanti|ida|往|往路|行き?|正|正向|去程?|前进|전진"
    r"|прям\w*|вперед|вверх|heen|fram|tam|oda|ileri|avant|avanco|subida|salita|dodatni\w*|(w )?przod"
)
DOWN = re.compile(
    r"-1?|↓|←|<+|d|dn|down|ab(waerts)?|b|bw|bwd|back|backwards?|r|rv|rev|reverse|retour|return|zur|zurueck|rueck(w|waerts|weg|fahrt)?"
    r"|her(weg|fahrt)?|n|neg|negative?|minus|falling|desc(ending)?|decreasing|fallend|above|oben|recul|descente|ritorno|indietro|vuelta|復|復路"
    r"|帰り?|反向?|[负負]向?|回程|后退|후진"
    r"|обратн\w*|назад|вниз|terug|tillbaka|zpet|geri|vissza|arriere|volta|retorno|retroceso|bajada"
    r"|discesa|ujemn\w*|(w )?tył"
)

# Those that mean forward and return pass: if targets fall, the forward pass is from above.
THERE_AND_BACK = re.compile(
    r"fw|fwd|forwards?|vor(w|waerts)?|hin(weg|fahrt)?|aller|andata|ida|往|往路|行き?"
    r"|b|bw|bwd|back|backwards?|rv|rev|reverse|retour|return|zur|zurueck|rueck(w|waerts|weg|fahrt)?|her(weg|fahrt)?"
    r"|ritorno|vuelta|復|復路|帰り?|v|h|прям\w*|вперед|обратн\w*|назад|heen|terug|fram|tillbaka|tam|zpet|oda|vissza|ileri|geri"
    r"|avance|avanco|avant|arriere|volta|retorno|retroceso|(w )?przod|(w )?tył|去程?|前进|전진|回程|后退|후진"
)

# Quantities in a difference, by their order: the command, the machine's own scale, the actual position.
_OF_A_DIFFERENCE = (
    (
        0,
        r"soll\w*|nomin[ae]l\w*|nom|visee?s?|nennwert|targets?|command\w*|cmd|set(?: ?point)?|sp|demand\w*|dem"
        r"|programmed|prog|reference|ref|consign[ea]|comand\w*|program\w*|doel\w*|gewenst\w*|cilov\w*|hedef\w*|theo\w*|cible|teoric\w*|objetivo|alvo|zadan\w*|задан\w*|指令\w*|目標\w*|目标\w*|理论\w*|목표\w*",
    ),
    (1, r"encoder|enc|(?:glass ?)?scale|display|anzeige|dro|machine|maschine|control(?:ler)?|steuerung"),
    (
        2,
        r"ist\w*|actual|act|real|feedback|fbk?|pv|measured|meas|mess\w*|readings?|mesure\w*|releve\w*|misurat\w*|medid\w*"
        r"|reel\w*|effettiv\w*|efectiv\w*|gemeten|werkelijk\w*|namer\w*|skutecn\w*|oe?lcue?l\w*|malt"
        r"|laser|interferometer|gauge|dial|indicator|zmierzon\w*|rzeczywist\w*|измерен\w*|фактич\w*|実測\w*|实测\w*|实际\w*|测量\w*|실측\w*",
    ),
)
_REFERENCE = re.compile(r"(?<![^\W_])ref(erence|erenz|erenz\w+)?(?![^\W_])")
MINUS_WORD = r"(?:minus|less|moins|meno|menos|eksi|минус|abzueglich)"
_NOUN = (  # before or after its adjective: `quota nominale`, `measured value`
    r"(?:pos|posi[tzc]\w*|values?|wert|readings?|quota|cot[ae]s?|val(?:ore?|eur)|waarde|verdi|pozyc\w*|wartosc|poloh\w*"
    r"|hodnot\w*|konum\w*|deger\w*|положен\w*|значен\w*)"
)
_LESS = rf"\.?(?: {_NOUN})?\s*(?:-|{MINUS_WORD})\s*(?:(?:the|axis|[xyzabcuvw]|{_NOUN}) ){{0,2}}"
_ONE, _OTHER = (
    "|".join(rf"(?P<{name}{n}>(?<![^\W_])(?:{pattern})(?![^\W_]))" for n, pattern in _OF_A_DIFFERENCE) for name in "ab"
)
_ACTUAL_AND_COMMANDED = re.compile(rf"(?:{_ONE}){_LESS}(?:{_OTHER})(?! ?-? ?(?:vergleich|comparison))")

# Words of a header that do not concern the sign of its readings.
_NEUTRAL = re.compile(
    r"readings?|values?|werte?|data|daten|results?|ergebnis(se)?|delta|diff(erence|erenz)?|probe|sensor|taster|channel"
    r"|kanal|axis|axe|asse|eje|achse|mittel(wert)?|mean|average|avg|median|the|von|der|des|and|und|raw|roh(wert)?|test"
    r"|pitch|yaw|roll\w*|nick\w*|gier\w*|level|tilt|neigung|inclination"
)

# Of an axis, with the number of a second one: X2. X1 is X, as controls also number a single one.
AXIS_LETTER = r"([XYZABCUVW](?:[2-9](?!\d))?)"
_CALLED_AXIS = (
    r"(?:axis|(?:mess|pruef|prüf|maschinen|linear|rund|dreh|schwenk|vorschub|haupt)?achse|achs(?:bezeichnung|name)"
    r"|axe|asse|eje|eixo|ось|oś|osa|eksen|ekseni|axel|tengely|as(?= ?:))\b"
    r"(?: (?:under test|tested|measured|name|id|letter|of (?:motion|travel|movement)|lin[eé]aire|lineare?"
    r"|mesuré))?"
)
_NUMBERED = r"(?:(?:(?:no|nr)\.? ?)?\d(?: ?[:=]| (?=\()))"  # `Axis: 1 (X)`, `Achse Nr. 2: Y`
_AXIS_ABOVE = re.compile(
    rf"(?:\b{_CALLED_AXIS}|[軸轴축][名号]?)\s{{0,9}}[:=;,：]?\s{{0,9}}{_NUMBERED}?\s{{0,9}}[\"'(\[]?{AXIS_LETTER}1?\b"
    rf"|\b{AXIS_LETTER}1?[- ]?(?:{_CALLED_AXIS}|[軸轴축])"
    r"|\b(?:linear(?: positioning)?|positioning|positionierung)[: ]{1,9}(?-i:([XYZ]))\b(?! ?-)",
    re.IGNORECASE,
)
_ALONG = re.compile(  # `X direction`, `Richtung: X`, `positioning error along X`
    r"\b([XYZABCUVW])[ -](?i:direction|richtung)\b"
    r"|\b(?i:(?:direction|richtung)(?: of (?:travel|motion|movement))?|along|entlang|laengs|längs)"
    r"\s{0,3}[:=]?\s{0,3}([XYZABCUVW])\b"
)
_ACROSS = re.compile(  # readings of one direction over the motion of another
    r"straight|gerad(?!e)|rectitud|rettilin|square|perpendic|recht|orthogon|flat|eben|parallel|probe|taster|sensor"
)
_AXIS_BEFORE = re.compile(
    r"\b([xyzabcuvw]\d?)(?=(?:cmd|act|fb|soll|ist|pos|ref|nom|meas|set|err|dev|enc)(?:[^a-z]|$))", re.IGNORECASE
)
_LETTERS = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "−": "-", "–": "-", "µ": "u", "μ": "u", "_": " "}
    | dict.fromkeys("⇑⬆▲△↗", "↑")
    | dict.fromkeys("⇓⬇▼▽↘", "↓")
    | dict.fromkeys("⇒⟶➡➔►▶", "→")
    | dict.fromkeys("⇐⟵⬅◄◀", "←")
)


def plain(text: object) -> str:
    """A text in the form of these patterns; `xAct` and `Xact` are `x act`."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", str(text).strip())
    spaced = _AXIS_BEFORE.sub(r"\1 ", spaced)
    word = unicodedata.normalize("NFKD", spaced.lower().translate(_LETTERS))
    return unicodedata.normalize("NFC", "".join(c for c in word if not unicodedata.combining(c)))


def kind_by_name(header: str) -> str | None:
    """The role of a column by its header, or None."""
    text = _measured(header)
    texts = [text.rpartition(":")[2], text] if re.search(r"[^\W\d]:(?=\S)", text) else [text]  # `TARGET_DU:X-PosAct`
    kind = next((kind for part in texts for pattern, kind in WORDS if re.search(pattern, part)), None)
    return "error" if kind in ("command", "actual", "position") and difference(header) else kind  # `Soll-Ist`


def _measured(header: str) -> str:
    """A header in the form of `plain`, without `temperature compensated` after or before the measured quantity."""
    text = plain(header)
    rest = _TO_20_DEGREES.sub(" ", text).strip()
    return rest if re.search(r"[^\W\d_]{2}", rest) else text


def unknown_word(header: str) -> str | None:
    """The first unknown word in a header of readings that may state their sign: `Fehlbetrag`; or None."""
    for word in re.findall(r"[^\W\d_]{3,}|[^\W\d_a-z]{2,}", plain(header)):
        if not _NEUTRAL.fullmatch(word) and kind_by_name(word) is None and not _ways_of(word):
            return word
    return None


def direction_word_in(header: str) -> str | None:
    """The direction word of a text, if all its direction words agree: `reverse` in `Run 2 reverse`."""
    found = [word for word in re.findall(r"[^\W\d_]+|[+\-↑↓→←]+", plain(header)) if _ways_of(word)]
    return found[-1] if direction_sign_of(header) is not None else None


def direction_sign_of(header: str) -> float | None:
    """+1 or -1 if exactly one word of a header is a direction: `Forward 1 (um)`; else None."""
    ways = {way for word in re.findall(r"[^\W\d_]+|[+\-↑↓→←]+", plain(header)) for way in _ways_of(word)}
    return ways.pop() if len(ways) == 1 else None


def way_of(word: str) -> float | None:
    """+1 or -1 for a word of direction in the form of `plain`, or None."""
    return next(iter(_ways_of(word)), None)


def _ways_of(word: str) -> list[float]:
    return [way for way, pattern in ((1.0, UP), (-1.0, DOWN)) if pattern.fullmatch(word)]


def is_correction(header: str) -> bool:
    """Whether a header names corrections; `error after correction` is an error."""
    text = _measured(header)
    named = re.search(CORRECTION, text) is not None and not is_error_of_a_correction(header)
    return named and not re.search(_STATE_OF_A_COMPENSATION, text)


def is_error_of_a_correction(header: str) -> bool:
    """Whether a header names the error of a correction: `comp. error` may be either; `error correction` is not."""
    of = re.search(rf"(?:{CORRECTION})\W+(?:errors?|err|fehler|erreur|errore)\b", _measured(header))
    return of is not None


def is_following_error(header: str) -> bool:
    """Whether a header names a quantity that controllers show as command minus actual position."""
    return re.search(FOLLOWING, plain(header)) is not None


def difference(text: str) -> tuple[float, str] | None:
    """+1 and the words if a text reads `measured - nominal`, -1 for `cmd - act`, 0 if it may be either; else None."""
    for match in _ACTUAL_AND_COMMANDED.finditer(plain(text)):
        one, other = sorted(name for name, word in match.groupdict().items() if word)
        if {one[1], other[1]} == {"0", "1"} and _REFERENCE.search(match.group(0)):
            return 0.0, match.group(0)  # `display - reference`: a set point, or the instrument beside the machine
        if one[1] != other[1]:
            return (1.0 if one[1] > other[1] else -1.0), match.group(0)
    return None


def is_reference_of_a_scale(command: str, actual: str) -> bool:
    """Whether a command may be the reading of an instrument: `Reference X` beside `Encoder X`."""
    return bool(_REFERENCE.search(plain(command)) and re.search(rf"\b(?:{_OF_A_DIFFERENCE[1][1]})\b", plain(actual)))


def names_command_and_actual(text: str) -> bool:
    """Whether a text names command and actual position, but not which is subtracted: `Soll zu Ist`."""
    (_, command), _, (_, actual) = _OF_A_DIFFERENCE
    found = [re.search(rf"(?<![^\W_])(?:{p})(?![^\W_])", plain(text)) for p in (command, actual)]
    return all(found) and difference(text) is None


def axis_above(lines: list[str]) -> str | None:
    """The axis named in the lines above a table."""
    for line in lines:
        match = _AXIS_ABOVE.search(line)
        if match:
            return next(filter(None, match.groups())).upper()
    for line in lines:
        named = {*re.findall(r"\b[XYZABCUVW]\b", line)}
        along = _ALONG.search(line) if len(named) == 1 and not _ACROSS.search(plain(line)) else None
        if along:
            return next(filter(None, along.groups()))
    return None
