"""The vocabulary of plants in six languages: what the words of a signal's name mean.

A name is split into concepts: its quantity (pressure, flow, command, …) and qualifiers (before the
valve, pilot, setpoint, …). A table per concept lists its words by language; tags of instruments
(ISA 5.1) and the letters of ports are in rows of their own.
"""

from collections.abc import Mapping
from enum import Enum, auto
from typing import Final


class Concept(Enum):
    """The meaning of a word in a signal's name."""

    PRESSURE = auto()
    FLOW = auto()
    TEMPERATURE = auto()
    COMMAND = auto()
    OPENING = auto()
    SPOOL = auto()
    POSITION = auto()
    SPEED = auto()
    ROTATION = auto()
    LEVEL = auto()
    LOAD = auto()
    VALVE = auto()
    BEFORE = auto()
    BEHIND = auto()
    SUPPLY = auto()
    TANK = auto()
    CONSUMER = auto()
    PORT_A = auto()
    PORT_B = auto()
    PILOT = auto()
    DIFFERENCE = auto()
    SETPOINT = auto()
    ACTUAL = auto()
    ESTIMATED = auto()
    LIMIT = auto()
    MACHINE = auto()
    STATUS = auto()


QUANTITIES: Final = frozenset(
    {
        Concept.PRESSURE,
        Concept.FLOW,
        Concept.TEMPERATURE,
        Concept.COMMAND,
        Concept.OPENING,
        Concept.SPOOL,
        Concept.POSITION,
        Concept.SPEED,
        Concept.ROTATION,
        Concept.LEVEL,
        Concept.LOAD,
    }
)
"""Concepts that name a quantity; the others qualify one."""

WORDS: Final[Mapping[Concept, Mapping[str, str]]] = {
    Concept.PRESSURE: {
        "en": "pressure press",
        "de": "druck oldruck vordruck",
        "fr": "pression",
        "es": "presion",
        "it": "pressione",
        "zh": "压力 油压 压强",
        "tags": "p p1 p2 pt pi pit cp pin pout pa pb pp ps px prs",
    },
    Concept.FLOW: {
        "en": "flow flowrate",
        "de": "durchfluss volumenstrom forderstrom",
        "fr": "debit",
        "es": "caudal flujo",
        "it": "portata flusso",
        "zh": "流量",
        "tags": "q ft fi fit cf qa qb qv",
    },
    Concept.TEMPERATURE: {
        "en": "temperature temp",
        "de": "temperatur oltemp",
        "fr": "temperature",
        "es": "temperatura",
        "it": "temperatura",
        "zh": "温度 油温",
        "tags": "t tt ti tit ct",
    },
    Concept.COMMAND: {
        "en": "command cmd voltage signal demand drive",
        "de": "stellwert stellgrosse stellgroesse stellsignal ansteuerung spannung steuersignal "
        "ventilstrom",
        "fr": "commande tension signal courant",
        "es": "mando comando tension senal",
        "it": "comando tensione segnale",
        "zh": "指令 控制信号 控制电压 控制量 给定 驱动",
        "tags": "u y mv co fcv lcv pcv",
    },
    Concept.OPENING: {
        "en": "opening",
        "de": "offnung oeffnung stellung ventilstellung offnungsgrad",
        "fr": "ouverture",
        "es": "apertura",
        "it": "apertura",
        "zh": "开度 阀位",
        "tags": "zt zi gt cg zc",
    },
    Concept.SPOOL: {
        "en": "spool lvdt",
        "de": "schieber schieberweg schieberposition ventilkolben",
        "fr": "tiroir",
        "es": "corredera",
        "it": "cursore cassetto",
        "zh": "阀芯 阀芯位移 滑阀",
        "tags": "xs lvdt",
    },
    Concept.POSITION: {
        "en": "position pos stroke displacement cylinder rod",
        "de": "position weg hub zylinderweg kolbenweg zylinder lage",
        "fr": "position course verin deplacement",
        "es": "posicion carrera cilindro desplazamiento",
        "it": "posizione corsa cilindro spostamento",
        "zh": "位移 位置 行程 油缸",
        "tags": "x lt zyl",
    },
    Concept.SPEED: {
        "en": "velocity speed",
        "de": "geschwindigkeit",
        "fr": "vitesse",
        "es": "velocidad",
        "it": "velocita",
        "zh": "速度",
        "tags": "v vel",
    },
    Concept.ROTATION: {
        "en": "rpm revolutions",
        "de": "drehzahl",
        "fr": "regime",
        "es": "revoluciones",
        "it": "giri",
        "zh": "转速",
        "tags": "n st",
    },
    Concept.LEVEL: {
        "en": "level",
        "de": "fullstand niveau pegel",
        "fr": "niveau",
        "es": "nivel",
        "it": "livello",
        "zh": "液位",
        "tags": "li lit",
    },
    Concept.LOAD: {
        "en": "force torque weight power vibration",
        "de": "kraft drehmoment moment gewicht leistung schwingung",
        "fr": "force couple poids puissance",
        "es": "fuerza par peso potencia",
        "it": "forza coppia peso potenza",
        "zh": "力矩 载荷 功率 力",
        "tags": "kn wt",
    },
    Concept.VALVE: {
        "en": "valve",
        "de": "ventil regelventil",
        "fr": "vanne distributeur servovalve",
        "es": "valvula",
        "it": "valvola",
        "zh": "阀 阀门",
        "tags": "",
    },
    Concept.BEFORE: {
        "en": "before upstream inlet in admission feed entering",
        "de": "vor vordruck zulauf zu eingang vorne",
        "fr": "amont entree avant",
        "es": "entrada arriba antes",
        "it": "ingresso monte",
        "zh": "上游 进口 入口 阀前 进油",
        "tags": "p1 pin up",
    },
    Concept.BEHIND: {
        "en": "after behind downstream outlet out leaving",
        "de": "nach hinter ablauf ab ausgang",
        "fr": "aval sortie apres",
        "es": "salida abajo despues",
        "it": "uscita valle",
        "zh": "下游 出口 阀后",
        "tags": "p2 pout down",
    },
    Concept.SUPPLY: {
        "en": "supply delivery system pump",
        "de": "versorgung systemdruck pumpendruck pumpe speisedruck",
        "fr": "alimentation pompe",
        "es": "alimentacion suministro bomba",
        "it": "alimentazione mandata pompa",
        "zh": "供油 泵 系统压力 油源",
        "tags": "ps pp",
    },
    Concept.TANK: {
        "en": "tank return drain reservoir",
        "de": "ruecklauf rucklauf tank",
        "fr": "retour reservoir bache",
        "es": "retorno tanque deposito",
        "it": "ritorno serbatoio scarico",
        "zh": "回油 油箱",
        "tags": "pr",
    },
    Concept.CONSUMER: {
        "en": "load consumer actuator",
        "de": "last verbraucher aktor",
        "fr": "charge recepteur utilisation",
        "es": "carga consumidor actuador",
        "it": "carico utilizzo utenza attuatore",
        "zh": "负载 执行器",
        "tags": "",
    },
    Concept.PILOT: {
        "en": "pilot",
        "de": "steuerdruck vorsteuer vorsteuerdruck pilotdruck steuerol",
        "fr": "pilotage pilote",
        "es": "pilotaje piloto",
        "it": "pilotaggio pilota",
        "zh": "先导 控制油",
        "tags": "px",
    },
    Concept.DIFFERENCE: {
        "en": "differential difference delta drop diff",
        "de": "differenz differenzdruck druckdifferenz druckabfall wirkdruck",
        "fr": "differentielle differentiel perte chute",
        "es": "diferencial diferencia caida",
        "it": "differenziale differenza caduta",
        "zh": "压差 差压",
        "tags": "dp pdt pdi pdit deltap",
    },
    Concept.SETPOINT: {
        "en": "setpoint set sp ref reference target",
        "de": "soll sollwert vorgabe fuhrungsgrosse",
        "fr": "consigne",
        "es": "consigna referencia",
        "it": "riferimento setpoint impostazione",
        "zh": "设定 设定值 目标",
        "tags": "w sp spt cons",
    },
    Concept.ACTUAL: {
        "en": "actual feedback measured act",
        "de": "ist istwert ruckmeldung gemessen",
        "fr": "mesure mesuree reel reelle recopie",
        "es": "real medido medida realimentacion",
        "it": "effettivo misurato retroazione reale misura",
        "zh": "实际 反馈 实测",
        "tags": "pv fb mes mess",
    },
    Concept.ESTIMATED: {
        "en": "calculated computed calc estimated estimate model simulated",
        "de": "berechnet errechnet geschatzt modell",
        "fr": "calcule calculee estime estimee modele",
        "es": "calculado calculada estimado estimada modelo",
        "it": "calcolato calcolata stimato stimata modello",
        "zh": "计算 估算 估计",
        "tags": "",
    },
    Concept.LIMIT: {
        "en": "alarm limit max min hh high low warning threshold gain offset",
        "de": "grenze grenzwert warnung schwelle",
        "fr": "seuil limite alarme",
        "es": "limite umbral alarma",
        "it": "limite soglia allarme",
        "zh": "报警 上限 下限",
        "tags": "hi lo ll hh",
    },
    Concept.MACHINE: {
        "en": "motor fan filter cooler heater gearbox bearing battery leak leakage bypass",
        "de": "lufter kuhler heizung getriebe lager leckage umlauf",
        "fr": "moteur ventilateur filtre fuite",
        "es": "motor ventilador filtro fuga",
        "it": "motore ventola filtro perdita trafilamento",
        "zh": "电机 过滤器 滤芯 风扇 泄漏",
        "tags": "",
    },
    Concept.STATUS: {
        "en": "status state quality simulation sim test fault error enable counter count hours "
        "mode sequence heartbeat timestamp time date spare reserve number index total tot "
        "totaliser totalizer totalised totalized cumulative accumulated",
        "de": "zustand fehler freigabe zahler laufzeit betriebsstunden modus zeit datum summe "
        "gesamtmenge",
        "fr": "etat defaut compteur heures totalisateur cumul cumule",
        "es": "estado fallo contador horas totalizador acumulado",
        "it": "stato guasto contatore ore totalizzatore cumulato",
        "zh": "状态 故障 计数 运行时间 时间 累计 累积 总量",
        "tags": "",
    },
}
"""Words by concept and language, without accents and case."""

PORT_LETTERS: Final[Mapping[str, tuple[Concept, ...]]] = {
    "p": (Concept.SUPPLY,),
    "s": (Concept.SUPPLY,),
    "t": (Concept.TANK,),
    "r": (Concept.TANK,),
    "a": (Concept.PORT_A,),
    "b": (Concept.PORT_B,),
    "x": (Concept.PILOT,),
    "1": (Concept.BEFORE,),
    "2": (Concept.BEHIND,),
}
"""The letter or number of a port behind a word for a pressure or a flow: pA, Druck 2, Q_B."""

COMPACT: Final[Mapping[str, tuple[Concept, ...]]] = {
    "pa": (Concept.PRESSURE, Concept.PORT_A),
    "pb": (Concept.PRESSURE, Concept.PORT_B),
    "qa": (Concept.FLOW, Concept.PORT_A),
    "qb": (Concept.FLOW, Concept.PORT_B),
    "dp": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdt": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdi": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdit": (Concept.PRESSURE, Concept.DIFFERENCE),
}
"""Words that hold two concepts."""
