"""Files of recordings as the specifications of their formats lay them out, from given accelerations.

Each writer returns the text of a file. The layouts were checked line by line against files that the networks
publish; the specification stands in the docstring of each reader.
"""

import numpy as np


def columns(values, form, per_line):
    """Values in a Fortran format, several to a line, one right beside the other."""
    cells = [form(value) for value in values]
    rows = ["".join(cells[k : k + per_line]) for k in range(0, len(cells), per_line)]
    return [row.rstrip() for row in rows]


def fixed(width, decimals):
    """F format: the zero before the point is left out where Fortran does."""

    def form(value):
        text = f"{value:{width}.{decimals}f}"
        return text.replace("-0.", " -.").replace(" 0.", "  .") if abs(value) < 1.0 else text

    return form


def exponent(value):
    """1PE10.4E1, "-3.8075E-2"."""
    mantissa, power = f"{value:.4e}".split("e")
    return f"{mantissa:>7}E{int(power):+d}"


def knet(counts, *, rate=100, scale="3920(gal)/6182761", direction="N-S", start="2006/01/18 23:25:46"):
    """K-NET ASCII: 17 lines of header, eight counts to a line; all seconds are whole."""
    above, below = scale.split("(gal)/")
    gal = float(above) / float(below) * (counts - np.mean(counts))
    head = {
        "Origin Time": "2006/01/18 23:25:00",
        "Lat.": "37.798",
        "Long.": "142.200",
        "Depth. (km)": "36",
        "Mag.": "5.7",
        "Station Code": "MYG002",
        "Station Lat.": "38.7262",
        "Station Long.": "141.5109",
        "Station Height(m)": "79",
        "Record Time": start,
        "Sampling Freq(Hz)": f"{rate}Hz",
        "Duration Time(s)": f"{len(counts) // rate}",
        "Dir.": direction,
        "Scale Factor": scale,
        "Max. Acc. (gal)": f"{np.abs(gal).max():.3f}",
        "Last Correction": "2006/01/18 23:25:31",
        "Memo.": "",
    }
    lines = [f"{label:<18}{value}" for label, value in head.items()]
    return "\n".join([*lines, *columns(counts, lambda n: f"{n:8d} ", 8)]) + "\n"


def cosmos(channels, dt, *, unit="cm/sec2(04)", quantity="acceleration"):
    """COSMOS V2, version 1.20: a block of headers above each channel {name: values}."""
    blocks = []
    for number, (name, values) in enumerate(channels.items(), 1):
        peak = values[np.argmax(np.abs(values))]
        reals = np.full(100, -999.0)
        reals[[33, 61, 62, 63]] = 0.5 * dt, 1e3 * dt, len(values) * dt, peak
        integers = np.full(100, -999)
        integers[:3] = 2, 1, 4
        blocks += [
            "Corrected acceleration    (Format v01.20 with 13 text lines) Src: 23075v2",
            "Record of an earthquake of Fri Nov 30, 2018 17:29 UTC",
            "Hypocenter: 61.34640 -149.95520 H= 46km Mw=7.0",
            "Origin: 2018/11/30 17:29:29    UTC",
            "Statn No: 01-23075  Code:CI-J2236  CDMG Yucaipa - Bryant & Oak Glen",
            "Coords: 34.0460 -117.0350  Site Geology:",
            "Recorder: SSA-2  s/n 1238 ( 1 Chns of 12  at Sta) Sensor:FBA-11  s/n 1889",
            "Rcrd start time:06/16/2005, 20:53:04.400 UTC (Q=2) RcrdId: 23075-L1889-05167.06",
            f"Sta Chan  {number}: {name} (Rcrdr Chan  {number}) Location: roof",
            "Raw record length = 70.000  sec, Uncor max =   -.167 g  at   27.850 sec",
            f"Processed: 06/17/2005,          PDT      Max = {peak:10.3f} cm/sec2",
            "Record filtered below 0.30  Hz (periods over  14.5 secs), and above 40.0 Hz",
            "Values used when parameter or data value is unknown/unspecified:   -999, -999.00",
            " 100 Integer-header values follow on  10 lines, Format= (10I8)",
            *columns(integers, lambda n: f"{n:8d}", 10),
            " 100 Real-header values follow on  17 lines, Format= (6F13.6)",
            *columns(reals, lambda x: f"{x:13.6f}", 6),
            '  2 Comment line(s) follow, each starting with a "|":',
            "| a comment, 7000 acceleration pts",
            "|",
            f"{len(values):7d} {quantity} pts, approx {round(len(values) * dt):4d} secs, units={unit},"
            "Format=(8F10.5)",
            *columns(values, fixed(10, 5), 8),
            f"End-of-data for chan {number:2d} {quantity}",
        ]
    return "\n".join(blocks) + "\n"


def _csmip_text(volume, name, first, fact):
    text = [f"{'a line of text':<80}"] * {1: 13, 2: 25}[volume]
    text[0] = first
    text[{1: 6, 2: 7}[volume]] = f"{name:<80}"
    for index, line in fact.items():
        text[index] = f"{line:<80}"
    return text


def _csmip_numbers(n_reals):
    integers = columns([1, 100, 13200, 360] * 25, lambda n: f"{n:5d}", 16)
    return [*integers, *columns([-999.0, 0.5] * (n_reals // 2), lambda x: f"{x:10.5f}", 8)]


def csmip_2(channels, dt, *, unit="cm/sec2"):
    """CSMIP volume 2: 45 lines above each channel, then acceleration, velocity and displacement."""
    lines = []
    for number, (name, values) in enumerate(channels.items(), 1):
        label = f"Chan  {number}: {name}"
        peak = f"Peak acceleration = {np.abs(values).max():9.3f}    cm/sec/sec  at   30.585   sec."
        first = f"Corrected accelerogram   89146-L2500-12044.02       {label}     from   "
        second = "Uncorrected Accelerogram Data             Processed: 02/13/12, CGS  146be002    "
        lines += _csmip_text(2, label, first, {1: second, 17: peak}) + _csmip_numbers(100)
        others = 0.1 * np.cumsum(values) * dt, 0.01 * values
        series = zip(("accel", "veloc", "displ"), (unit, "cm/sec", "cm"), (values, *others), strict=True)
        for quantity, word, history in series:
            count = f"{len(history):6d} points of {quantity} data equally spaced at {dt:5.3f} sec, "
            lines.append(f"{count}in {word}. (8f10.6)")
            lines += columns(history, fixed(10, 6), 8)
        lines.append(f"/&  ----------  End of data for channel  {number} ----------")
    return "\n".join(lines) + "\n"


def csmip_1(channels, dt):
    """CSMIP volume 1 of digital recorders, in g."""
    lines = []
    for number, (name, values) in enumerate(channels.items(), 1):
        first = "Uncorrected Accelerogram Data             Processed: 02/13/12, CGS  146be002    "
        count = f"No. of Points = {len(values):6d}  Record Length = 66.000 sec   at 200 Samples/sec"
        units = f"Units of uncor data are sec and g .        Max  = {np.abs(values).max():6.3f} g ,"
        lines += _csmip_text(1, f"Chan  {number}: {name}", first, {10: count, 11: units}) + _csmip_numbers(50)
        count = f"{len(values):6d} Accelerogram points at {1 / dt:3.0f} pts/sec in units of g ."
        lines.append(f"{count}      Format: (8f9.6)  ")
        lines += columns(values, fixed(9, 6), 8)
        lines.append(f"/&  ----------  End of data for channel  {number} ----------")
    return "\n".join(lines) + "\n"


def csmip_film(times, values, name="90 DEG"):
    """CSMIP volume 1 of film: pairs of time and value in tenths of g."""
    first = "UNCORRECTED ACCELEROGRAM DATA              PROCESSED: 02/08/94, CDMG QN94A403   "
    facts = {
        10: f"NO. OF POINTS = {len(times):6d}  RECORD LENGTH = 59.998 SEC",
        11: "UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  =  -.200 G, AT  11.576 SEC.",
    }
    pairs = np.column_stack([times, values]).ravel()
    lines = _csmip_text(1, f"CHAN  1: {name}", first, facts) + _csmip_numbers(50)
    return (
        "\n".join([*lines, *columns(pairs, fixed(7, 3), 10), "/&  -- END OF DATA FOR CHANNEL  1 --"]) + "\n"
    )


def csmip_3():
    """CSMIP volume 3, spectra."""
    second = "Corrected accelerogram   15481673.CI.WLT.--.HN      Chan  1:  90 Deg     from"
    return f"Response and Fourier amplitude spectra (86 periods,  .04 - 10.0 sec)   for\n{second}\n"


def smc(values, rate, *, title="2 CORRECTED ACCELEROGRAM"):
    """SMC: even values, or with rate None pairs of time and value."""
    accelerations = values if rate else values[1::2]
    reals = np.full(50, 1.7e38)
    reals[[29, 31]] = accelerations.max(), accelerations.min()
    reals[1] = rate or 1.7e38
    integers = np.full(48, -32768)
    integers[[1, 15, 16]] = 1989, 2, len(values)
    lines = [
        f"{title:<80}",
        "*",
        "SAF0A",
        "     1989  10  18    0004 Loma Prieta, CA",
        "Moment Mag=      7.1 Ms=      7.1 Ml=      7.0",
        "station = San Francisco, 1295 Shafter, F component=    360",
        "epicentral dist =     89.0       pk     =    104.4",
        "inst type=SMA-1      data source = USGS",
        "*",
        "*",
        "*",
        *columns(integers, lambda n: f"{n:10d}", 8),
        *columns(reals, lambda x: f"{x:15.7E}", 5),
        "|",
        "|ref - R. Maley, 1989, 568 p.",
        *columns(values, exponent, 8),
    ]
    return "\n".join(lines) + "\n"


def geonet(components, dt, *, volume=2):
    """GeoNet V1A or V2A: 26 lines above each component, in mm/s^2."""
    lines = []
    for name, values in components.items():
        n_times = len(values)
        others = 0 if volume == 1 else n_times
        integers = np.zeros(40, dtype=int)
        integers[[0, 30, 33, 34, 35]] = 2016, n_times if volume == 1 else 8 * n_times, n_times, others, others
        reals = np.zeros(60)
        reals[[0, 24, 25]] = 200.0, dt if volume == 1 else dt / 4, dt
        kind = "Uncorrected" if volume == 1 else "Corrected"
        interval = (
            f"Raw readings in units of 1.00 mm/s/s  at intervals of {dt:5.3f} s"
            if volume == 1
            else f"Instrument corrected data at {dt:5.3f} sec intervals"
        )
        lines += [
            f"{kind} accelerogram 20161113_110256_WTMC_20 GNS Science",
            "Site WTMC      42 37 10S  173 03 13E     Cusp file:  20161113_110259_WTMC",
            "Te Mara Farm Waiau",
            "Instrument Cusp_10462",
            "Resolution: 18-bit   Instr Period: 0.0050 s   Damping: 0.700",
            "Accelerogram 20161113_110256_WTMC_20                 Processed 2016 December 09",
            "5 km south-west of Waiau",
            "2016 November 13         11:02:56 UT",
            "Epicentre  42 41 33S 173 01 19E  Bearing S18W  Dist    9km  Depth   15km Mw 7.82",
            f"Number of points {n_times:5d}    Duration {n_times * dt:6.2f} sec",
            interval,
            "Band-pass filter transition bands are .10-.25 Hz and 24.50-25.50 Hz",
            f"Component {name}  Longitudinal Accelerometer Axis",
            f"Acceleration:  peak  {np.abs(values).max():.1f} mm/s/s at  44.88 sec     rms    719.0 mm/s/s",
            "Velocity:      peak -1016.55 mm/s   at  46.58 sec     rms    96.10 mm/s",
            "Displacement:  peak  234.852 mm     at  46.36 sec     rms   38.013 mm",
            *columns(integers, lambda n: f"{n:8d}", 10),
            *columns(reals, lambda x: f"{x:8.4f}", 10),
            *columns(values, lambda x: f"{x:8.1f}", 10),
        ]
        for _ in range(2 if volume == 2 else 0):
            lines += columns(0.5 * values, lambda x: f"{x:8.2f}", 10)
    return "\n".join(lines) + "\n"


def esm(values, dt, *, units="cm/s^2", kind="ACCELERATION"):
    """ESM, HEADER_FORMAT DYNA 1.2: labels, then one value to a line."""
    facts = {
        "EVENT_NAME": "GREECE",
        "EVENT_ID": "EMSC-20190728_0000106",
        "EVENT_DATE_YYYYMMDD": "20190728",
        "EVENT_TIME_HHMMSS": "160908",
        "MAGNITUDE_W": "",
        "NETWORK": "HI",
        "STATION_CODE": "ARS1",
        "VS30_M/S": "",
        "DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS": "20190728_160919.870",
        "SAMPLING_INTERVAL_S": f"{dt:.6f}",
        "NDATA": f"{len(values)}",
        "DURATION_S": f"{len(values) * dt:.3f}",
        "STREAM": "HNN",
        "UNITS": units,
        "PGA_CM/S^2": f"{values[np.argmax(np.abs(values))]:.6f}",
        "BASELINE_CORRECTION": "BASELINE REMOVED",
        "HEADER_FORMAT": "DYNA 1.2",
        "DATA_TYPE": kind,
        "USER1": "processing.py --le 0.100 --he 30.000",
        "USER5": "",
    }
    lines = [f"{label}: {value}" for label, value in facts.items()]
    return "\n".join([*lines, *(f"{value:.6f}" for value in values)]) + "\n"


def nsmn(components, dt):
    """NSMN: labels, directions, three columns in gal."""
    values = np.column_stack(list(components.values()))
    lines = [
        "STRONG GROUND MOTION RECORDS OF TURKIYE",
        "PLACE                   : GERMENCIK",
        "EARTHQUAKE DATE         : 2017/07/20 22:31:09 (GMT)",
        "STATION ID              : 0921",
        f"NUMBER OF DATA          : {len(values)}",
        f"SAMPLING INTERVAL (sec) : {dt:g}",
        "RAW PGA VALUES (gal)    : (N-S) 13.200332 (E-W) 12.163827 (U-D) 9.840572",
        "Copyright EARTHQUAKE DEPARTMENT",
        "DISASTER AND EMERGENCY MANAGEMENT PRESIDENCY",
        "".join(f"{name:>13}" for name in components),
        *("".join(f"{x:13.6f}" for x in row) for row in values),
    ]
    return "\n".join(lines) + "\n"


def unam(components, dt):
    """UNAM, formato 2.0: labels in Spanish, then columns 3F10.4 in gal."""
    values = np.column_stack(list(components.values()))
    n_channels, n_times = len(components), len(values)

    def each(text):
        return "".join(f"/{text}" for _ in range(n_channels))

    facts = {
        "VERSION DEL FORMATO": "2.0",
        "NUMERO DE CANALES": str(n_channels),
        "ORIENTACION C1-C6 (rumbo;orientacion)": "".join(f"/{name}" for name in components),
        "ORIENTACION C7-C12 (rumbo;orientacion)": "",
        "VEL. DE MUESTREO, C1-C6 (muestras/s)": each(f"{1 / dt:.0f}"),
        "INTERVALO DE MUESTREO, C1-C6 (s)": each(f"{dt:g}"),
        "INTERVALO DE MUESTREO, C7-C12 (s)": "",
        "DURACION DEL REGISTRO (s), C1-C6": each(f"{n_times * dt:.2f}"),
        "NUM. TOTAL DE MUESTRAS, C1-C6": each(n_times),
        "NUM. TOTAL DE MUESTRAS, C7-C12": "",
        "ACEL. MAX.(Gal), C1-C6": "".join(f"/{x[np.argmax(np.abs(x))]:.2f}" for x in components.values()),
        "ACEL. MAX., C1-C6, EN LA MUESTRA": each(7),
        "UNIDADES DE LOS DATOS": "Gal (cm/s/s)",
        "FACTOR DE DECIMACION": "1",
        "FORMATO DATOS (FORTRAN,10 campos/dato)": f"{n_channels}F10.4",
    }
    rule = "---------+" * 7
    lines = [
        86 * "*",
        "                       INSTITUTO DE INGENIERIA, UNAM",
        86 * "*",
        "ARCHIVO ESTANDAR DE ACELERACION:",
        *(f"{label:<39}: {value}" for label, value in facts.items()),
        80 * "=",
        "DATOS DE ACELERACION:",
        rule,
        "".join(f"{f'CANAL-{k + 1}':>10}" for k in range(n_channels)),
        "".join(f"{name:>10}" for name in components),
        rule,
        *("".join(f"{x:10.4f}" for x in row) for row in values),
    ]
    return "\n".join(lines) + "\n"


def at2(values, dt):
    """PEER AT2 of the NGA-West2 flatfile."""
    lines = [
        "PEER NGA STRONG MOTION DATABASE RECORD",
        "Imperial Valley-06, 10/15/1979, El Centro Array #6, 230",
        "ACCELERATION TIME SERIES IN UNITS OF G",
        f"NPTS={len(values):7d}, DT= {dt:.4f} SEC",
        *columns(values, lambda x: f"{x:15.7E}", 5),
    ]
    return "\n".join(lines) + "\n"
