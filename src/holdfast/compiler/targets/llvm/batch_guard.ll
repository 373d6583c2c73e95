; `differences` adds x - x, which is 0 for every finite x, to a sum; `blank` writes NaN to the results of bad systems.

declare i1 @llvm.vector.reduce.or.v${lanes}i1(<$lanes x i1>)

; Four sums are added up side by side, because each addition waits for the one before; the last number may be added twice.

define internal $T @differences(ptr %x, i64 %n, $T %before) noinline nounwind {
entry:
  %end = sub i64 %n, 1
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %sum0 = phi $T [ %before, %entry ], [ %sum0.next, %next ]
  %sum1 = phi $T [ $zero, %entry ], [ %sum1.next, %next ]
  %sum2 = phi $T [ $zero, %entry ], [ %sum2.next, %next ]
  %sum3 = phi $T [ $zero, %entry ], [ %sum3.next, %next ]
  %e0 = add i64 %e, 0
  %i0 = call i64 @llvm.smin.i64(i64 %e0, i64 %end)
  %k0 = mul i64 %i0, $lanes
  %at0 = getelementptr double, ptr %x, i64 %k0
  %v0 = load $T, ptr %at0, align $align
  %d0 = fsub $T %v0, %v0
  %sum0.next = fadd $T %sum0, %d0
  %e1 = add i64 %e, 1
  %i1 = call i64 @llvm.smin.i64(i64 %e1, i64 %end)
  %k1 = mul i64 %i1, $lanes
  %at1 = getelementptr double, ptr %x, i64 %k1
  %v1 = load $T, ptr %at1, align $align
  %d1 = fsub $T %v1, %v1
  %sum1.next = fadd $T %sum1, %d1
  %e2 = add i64 %e, 2
  %i2 = call i64 @llvm.smin.i64(i64 %e2, i64 %end)
  %k2 = mul i64 %i2, $lanes
  %at2 = getelementptr double, ptr %x, i64 %k2
  %v2 = load $T, ptr %at2, align $align
  %d2 = fsub $T %v2, %v2
  %sum2.next = fadd $T %sum2, %d2
  %e3 = add i64 %e, 3
  %i3 = call i64 @llvm.smin.i64(i64 %e3, i64 %end)
  %k3 = mul i64 %i3, $lanes
  %at3 = getelementptr double, ptr %x, i64 %k3
  %v3 = load $T, ptr %at3, align $align
  %d3 = fsub $T %v3, %v3
  %sum3.next = fadd $T %sum3, %d3
  %e.next = add i64 %e, 4
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  %a = fadd $T %sum0.next, %sum1.next
  %b = fadd $T %sum2.next, %sum3.next
  %sum = fadd $T %a, %b
  ret $T %sum
}

define internal void @blank(ptr %x, i64 %n, <$lanes x i1> %bad) noinline nounwind {
entry:
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %k = mul i64 %e, $lanes
  %at = getelementptr double, ptr %x, i64 %k
  %v = load $T, ptr %at, align $align
  %w = select <$lanes x i1> %bad, $T $nan, $T %v
  store $T %w, ptr %at, align $align
  %e.next = add i64 %e, 1
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  ret void
}
