; a b + c rounded once to nearest even, in integer arithmetic, for processors without an fma instruction.

declare i64 @llvm.ctlz.i64(i64, i1)
declare i128 @llvm.ctlz.i128(i128, i1)

; Return the mantissa of a finite nonzero x, with its leading bit at position 52, and the exponent of its last bit.
define internal { i64, i64 } @exact.apart(double %x) noinline nounwind {
  %bits = bitcast double %x to i64
  %field.0 = lshr i64 %bits, 52
  %field = and i64 %field.0, 2047
  %fraction = and i64 %bits, 4503599627370495
  %tiny = icmp eq i64 %field, 0
  %whole = or i64 %fraction, 4503599627370496
  %zeros = call i64 @llvm.ctlz.i64(i64 %fraction, i1 false)
  %up.0 = sub i64 %zeros, 11
  %up = select i1 %tiny, i64 %up.0, i64 0
  %shifted = shl i64 %fraction, %up
  %mantissa = select i1 %tiny, i64 %shifted, i64 %whole
  %smallest = sub i64 -1074, %up
  %usual = sub i64 %field, 1075
  %exponent = select i1 %tiny, i64 %smallest, i64 %usual
  %r.0 = insertvalue { i64, i64 } poison, i64 %mantissa, 0
  %r = insertvalue { i64, i64 } %r.0, i64 %exponent, 1
  ret { i64, i64 } %r
}

; Return x shifted right by n >= 0 places; if any bit that is lost is set, the last bit is set.
define internal i128 @exact.down(i128 %x, i64 %n) noinline nounwind {
  %far = icmp ugt i64 %n, 127
  %m.0 = select i1 %far, i64 127, i64 %n
  %m = zext i64 %m.0 to i128
  %y = lshr i128 %x, %m
  %back = shl i128 %y, %m
  %lost = icmp ne i128 %back, %x
  %last = zext i1 %lost to i128
  %r = or i128 %y, %last
  ret i128 %r
}

define internal double @exact.fma.f64(double %a, double %b, double %c) noinline nounwind {
entry:
  %rounded = fmul double %a, %b
  %plain = fadd double %rounded, %c
  %a0 = fsub double %a, %a
  %b0 = fsub double %b, %b
  %c0 = fsub double %c, %c
  %ab0 = fadd double %a0, %b0
  %abc0 = fadd double %ab0, %c0
  %odd = fcmp une double %abc0, 0.0
  %za = fcmp oeq double %a, 0.0
  %zb = fcmp oeq double %b, 0.0
  %zc = fcmp oeq double %c, 0.0
  %zab = or i1 %za, %zb
  %zabc = or i1 %zab, %zc
  %simple = or i1 %odd, %zabc
  br i1 %simple, label %special, label %general

special:  ; a b is exact, or the result's rounding is its own, or a or b is not finite
  %fc = fcmp une double %c0, 0.0
  %fab = fcmp oeq double %ab0, 0.0
  %only.c = and i1 %fc, %fab
  %some = xor i1 %zab, true
  %only.ab = and i1 %zc, %some
  %s.0 = select i1 %only.ab, double %rounded, double %plain
  %s = select i1 %only.c, double %c, double %s.0
  ret double %s

general:
  %A = call { i64, i64 } @exact.apart(double %a)
  %B = call { i64, i64 } @exact.apart(double %b)
  %C = call { i64, i64 } @exact.apart(double %c)
  %ma.0 = extractvalue { i64, i64 } %A, 0
  %mb.0 = extractvalue { i64, i64 } %B, 0
  %mc.0 = extractvalue { i64, i64 } %C, 0
  %ma = zext i64 %ma.0 to i128
  %mb = zext i64 %mb.0 to i128
  %mc = zext i64 %mc.0 to i128
  %ea = extractvalue { i64, i64 } %A, 1
  %eb = extractvalue { i64, i64 } %B, 1
  %ec = extractvalue { i64, i64 } %C, 1
  ; Both have their leading bits at 122 or 123, so that a sum does not overflow and a shift by a few places is exact.
  %mm = mul i128 %ma, %mb
  %p = shl i128 %mm, 18
  %q = shl i128 %mc, 71
  %eab = add i64 %ea, %eb
  %ep = sub i64 %eab, 18
  %eq = sub i64 %ec, 71
  %above = sub i64 %ep, %eq
  %below = sub i64 0, %above
  %p.high = icmp sge i64 %above, 0
  %e = select i1 %p.high, i64 %ep, i64 %eq
  %p.by = select i1 %p.high, i64 0, i64 %below
  %q.by = select i1 %p.high, i64 %above, i64 0
  %P = call i128 @exact.down(i128 %p, i64 %p.by)
  %Q = call i128 @exact.down(i128 %q, i64 %q.by)
  %a.bits = bitcast double %a to i64
  %b.bits = bitcast double %b to i64
  %c.bits = bitcast double %c to i64
  %ab.bits = xor i64 %a.bits, %b.bits
  %apart.bits = xor i64 %ab.bits, %c.bits
  %apart = icmp slt i64 %apart.bits, 0
  %p.larger = icmp uge i128 %P, %Q
  %sum = add i128 %P, %Q
  %p.less.q = sub i128 %P, %Q
  %q.less.p = sub i128 %Q, %P
  %difference = select i1 %p.larger, i128 %p.less.q, i128 %q.less.p
  %total = select i1 %apart, i128 %difference, i128 %sum
  %of.c = xor i1 %p.larger, true
  %of.larger = select i1 %of.c, i64 %c.bits, i64 %ab.bits
  %sign = and i64 %of.larger, -9223372036854775808
  %none = icmp eq i128 %total, 0
  br i1 %none, label %zero, label %round

zero:
  ret double 0.0

round:  ; 55 bits: 53 of the result and two that say how to round; fewer of a subnormal one
  %zeros.0 = call i128 @llvm.ctlz.i128(i128 %total, i1 true)
  %zeros = trunc i128 %zeros.0 to i64
  %leading = sub i64 127, %zeros
  %exponent = add i64 %e, %leading
  %biased = add i64 %exponent, 1023
  %huge = icmp sgt i64 %biased, 2046
  br i1 %huge, label %infinite, label %finite

infinite:
  %inf.bits = or i64 %sign, 9218868437227405312
  %inf = bitcast i64 %inf.bits to double
  ret double %inf

finite:
  %subnormal = icmp slt i64 %biased, 1
  %missing.0 = sub i64 1, %biased
  %missing = select i1 %subnormal, i64 %missing.0, i64 0
  %field.0 = sub i64 %biased, 1
  %field = select i1 %subnormal, i64 0, i64 %field.0
  %top = shl i128 %total, %zeros.0
  %by = add i64 %missing, 73
  %kept.0 = call i128 @exact.down(i128 %top, i64 %by)
  %kept = trunc i128 %kept.0 to i64
  %cut = lshr i64 %kept, 2
  %rest = and i64 %kept, 3
  %last = and i64 %cut, 1
  %more = icmp eq i64 %rest, 3
  %half = icmp eq i64 %rest, 2
  %is.odd = icmp eq i64 %last, 1
  %up.even = and i1 %half, %is.odd
  %up = or i1 %more, %up.even
  %one = zext i1 %up to i64
  %mantissa = add i64 %cut, %one
  %high = shl i64 %field, 52
  %magnitude = add i64 %high, %mantissa
  %bits = or i64 %magnitude, %sign
  %result = bitcast i64 %bits to double
  ret double %result
}
